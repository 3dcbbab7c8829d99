"""The file `can/canmap.json`, the normative description of the robot's CAN buses, and the load of
the buses as JSON and as a Markdown table.

The page docs/canmap.md describes the formats.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable, Iterator
from typing import Any

from thorvaldc.diagnostics.text_layout import markdown_table
from thorvaldc.model import Actuator, Bus, Channel, FrameDefinition, Joint, Node, Robot, Signal
from thorvaldc.model.bus import key_text
from thorvaldc.model.bus_timing import worst_case_bits
from thorvaldc.model.sums import float_sum

FORMAT = "thorvaldc-canmap"
VERSION = 4
BUDGET_FORMAT = "thorvaldc-can-budget"
BUDGET_VERSION = 2
BUDGET_HEAD = (
    *("id", "frame", "from", "bytes", "bits"),
    *("period ms", "load %", "response ms", "deadline ms"),
)
RIGHT = (0, *range(3, len(BUDGET_HEAD)))  # columns of numbers
JOINT_UNITS = ("rad", "rad/s")
Motors = dict[str, tuple[Actuator, Joint]]


def _marked_text(number: Any) -> str:
    """Returns the text of a number of `why`, which writes a mark before its digits."""
    if not isinstance(number, int | float):
        raise TypeError(f"canmap.json cannot contain {number!r}")
    return str(number)


_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, default=_marked_text)


def canmap_text(robot: Robot) -> str:
    """Return the contents of canmap.json as text, in the layout of ``json_text``."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "robot": robot.name,
        "namespace": robot.namespace,
        "buses": [_bus(robot, bus) for bus in robot.buses],
    }
    return json_text(head)


def _bus(robot: Robot, bus: Bus) -> dict[str, Any]:
    joints = {joint.name: joint for joint in robot.joints}
    motors = {a.name: (a, joints[a.joint]) for a in robot.actuators}
    frames: dict[str, list[FrameDefinition]] = {}
    for frame in bus.frames:
        for name in (frame.producer, *frame.consumers):
            frames.setdefault(name, []).append(frame)
    return {
        "name": bus.name,
        "bitrate": bus.bitrate,
        "sync_period": bus.sync_period,
        "load": bus.load,
        "master": {"name": "master", "id": bus.master_id},
        "nodes": [_node(node, motors, frames.get(node.name, [])) for node in bus.nodes],
        "frames": [_frame(frame) for frame in bus.frames],
    }


def _fields(element: object, names: str) -> dict[str, Any]:
    """Return fields of the model under their names."""
    return {name: getattr(element, name) for name in names.split()}


def _if_true(element: object, name: str) -> dict[str, bool]:
    """Return a field of the model under its name, or nothing if the field is false."""
    return {name: True} if getattr(element, name) else {}


def _node(node: Node, motors: Motors, frames: list[FrameDefinition]) -> dict[str, Any]:
    return {
        **_fields(node, "name module protocol id id_space vendor_id product_code revision_number"),
        **_fields(node, "serial device_type lss heartbeat_timeout heartbeat_consumer_time"),
        **_fields(node, "command_watchdog watchdog_coasts"),
        "bitrates": list(node.bitrates),
        "properties": dict(node.properties),
        "channels": [_channel(node, channel, motors, frames) for channel in node.channels],
    }


def _channel(
    node: Node, channel: Channel, motors: Motors, frames: list[FrameDefinition]
) -> dict[str, Any]:
    description: dict[str, Any] = {"name": channel.name, "role": channel.role, "actuator": None}
    if channel.actuator is None:
        return description
    actuator, joint = motors[channel.actuator]
    return {
        **description,
        "actuator": actuator.name,
        "joint": joint.name,
        **_fields(actuator, "gear_ratio encoder_ppr motor_max_speed max_velocity max_acceleration"),
        **_fields(joint, "lower upper"),
        "signals": [
            {
                "frame": frame.name,
                "signal": signal.name,
                "direction": "report" if frame.producer == node.name else "command",
                **_fields(signal, "unit scale offset"),
            }
            for frame in frames
            for signal in frame.signals
            if signal.joint == actuator.joint and signal.unit in JOINT_UNITS
        ],
    }


def _frame(frame: FrameDefinition) -> dict[str, Any]:
    return {
        **_fields(frame, "name cob_id kind producer"),
        **_if_true(frame, "extended"),
        "consumers": list(frame.consumers),
        **_fields(frame, "length period deadline minimum_interval response_time pdo"),
        "mapping": [list(entry) for entry in frame.mapping],
        **_fields(frame, "synchronous description"),
        "signals": [_signal(signal) for signal in frame.signals],
    }


def _signal(signal: Signal) -> dict[str, Any]:
    return {
        **_fields(signal, "name start length signed floating_point scale offset unit minimum"),
        **_fields(signal, "maximum joint multiplexer"),
        **_if_true(signal, "big_endian"),
        "selected_by": list(signal.selected_by),
        "choices": {name: raw for raw, name in signal.choices},
        "description": signal.description,
    }


def json_text(document: dict[str, Any]) -> str:
    """Return a document as JSON text with a layout that is easy to read.

    A JSON list or object without nested lists and objects is written on one line. With this JSON
    layout, a text comparison of two versions of a document is easy to read.
    """
    return _layout(document, 0) + "\n"


def _layout(value: Any, depth: int) -> str:
    pad = "\n" + "  " * depth
    if type(value) is dict and not all(map(_is_flat, _containers(value.values()))):
        rows = [f"{pad}  {_text(k)}: {_layout(v, depth + 1)}" for k, v in value.items()]
        return "{" + ",".join(rows) + pad + "}"
    if type(value) is list and _containers(value):
        return "[" + ",".join([f"{pad}  {_layout(v, depth + 1)}" for v in value]) + pad + "]"
    return _text(value) if type(value) is str else _ENCODER.encode(value)


# One call of the JSON encoder takes several microseconds, and most texts occur many times.
@functools.lru_cache(maxsize=1 << 12)
def _text(text: str) -> str:
    return _ENCODER.encode(text)


def _is_flat(container: Any) -> bool:
    """True for a JSON list or object that contains no lists and no objects."""
    return not _containers(container.values() if type(container) is dict else container)


def _containers(values: Iterable[Any]) -> list[Any]:
    return [v for v in values if type(v) is dict or type(v) is list]


# -- load of each bus, and worst-case response times of its frames ---------------------


def budget_json(robot: Robot) -> str:
    """Return the load of each CAN bus and the response time of each CAN frame as JSON text."""
    return json_text(
        {
            "format": BUDGET_FORMAT,
            "version": BUDGET_VERSION,
            "robot": robot.name,
            "buses": [
                {
                    "name": bus.name,
                    "bitrate": bus.bitrate,
                    "load": bus.load,
                    "frames": [_row(bus, frame) for frame in _by_urgency(bus)],
                }
                for bus in robot.buses
            ],
        }
    )


def _by_urgency(bus: Bus) -> list[FrameDefinition]:
    return sorted(bus.frames, key=lambda frame: frame.arbitration)


def _row(bus: Bus, frame: FrameDefinition) -> dict[str, Any]:
    bits = worst_case_bits(frame.length, frame.extended)
    interval = frame.period or frame.minimum_interval
    return {
        **_fields(frame, "name cob_id producer length"),
        **_if_true(frame, "extended"),
        "bits": bits,
        "transmission_time": bits / bus.bitrate,
        **_fields(frame, "period minimum_interval"),
        "load": bits / bus.bitrate / interval if interval else None,
        **_fields(frame, "response_time deadline"),
    }


def budget_table(robot: Robot) -> str:
    """Return the load of each CAN bus and the response time of each CAN frame as Markdown tables.

    The columns of the Markdown tables are aligned.
    """
    lines = [
        f"# Load of the buses of {robot.name}",
        "",
        "Most urgent first. Response: the longest time until a frame is received when all others",
        "come at the worst instant (Davis, Burns, Bril, Lukkien 2007); that of commands, of SYNC",
        "and of what follows SYNC counts from the beginning of the control cycle. No period: sent",
        "on demand, one such frame of the master in a cycle; an SDO is answered within a cycle.",
    ]
    for bus in robot.buses:
        lines += ["", f"## {bus.name}", ""]
        stated = float_sum(_row(bus, frame)["load"] or 0.0 for frame in bus.frames)
        lines += [
            f"{bus.bitrate / 1000:g} kbit/s, load {100 * bus.load:.1f} % at worst: "
            f"{100 * stated:.1f} % below, {100 * (bus.load - stated):.1f} % for frames on demand.",
            "",
            *_table(bus),
        ]
    return "\n".join(lines) + "\n"


def _table(bus: Bus) -> Iterator[str]:
    rows = [BUDGET_HEAD]
    for frame in _by_urgency(bus):
        load = _row(bus, frame)["load"]
        rows.append(
            (
                key_text(frame.key),
                frame.name,
                frame.producer,
                str(frame.length),
                str(worst_case_bits(frame.length, frame.extended)),
                _milliseconds(frame.period or frame.minimum_interval, "g"),
                f"{100 * load:.2f}" if load else "-",
                _milliseconds(frame.response_time, ".3f"),
                _milliseconds(frame.deadline, "g"),
            )
        )
    return markdown_table(rows, right=RIGHT, aligned=True)


def _milliseconds(time: float | None, form: str) -> str:
    return format(round(time * 1000, 6), form) if time is not None else "-"
