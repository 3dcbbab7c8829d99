"""The CAN map: `can/canmap.json`, which is normative, and a DBC for tools.

docs/canmap.md describes the JSON.  Everything in it was computed before: ids,
COB-IDs and scalings are those of the model.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
from collections.abc import Iterable
from typing import Any

from thorvaldc.backends import Backend
from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.model import Robot
from thorvaldc.model.robot import Actuator, Bus, Channel, Frame, Joint, Node, Signal

FORMAT = "thorvaldc-canmap"
VERSION = 2
DBC_ENCODING = "cp1252"  # what readers of DBC files take for granted
JOINT_UNITS = ("rad", "rad/s")
Motors = dict[str, tuple[Actuator, Joint]]
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


class Can(Backend):
    name = "can"
    summary = "CAN map (JSON) and DBC of each bus"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        files = {"can/canmap.json": canmap_text(robot).encode()}
        for bus in robot.buses:
            path = "can/robot.dbc" if len(robot.buses) == 1 else f"can/{bus.name}.dbc"
            files[path] = dbc_text(bus).encode(DBC_ENCODING, "replace")
        return files

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        for bus in robot.buses:
            for frame in bus.frames:
                texts = [frame.description]
                for signal in frame.signals:
                    texts += (signal.description, signal.unit)
                lost = [c for c in dict.fromkeys("".join(texts)) if not _in_dbc(c)]
                if lost:
                    yield Diagnostic(
                        CODES["dbc-text"],
                        f"the texts of `{frame.name}` have characters that a DBC file cannot "
                        f"hold: {' '.join(lost[:8])}",
                        frame.origin,
                        "they are `?` there; the CAN map has them all",
                    )


def _in_dbc(character: str) -> bool:
    try:
        character.encode(DBC_ENCODING)
    except UnicodeEncodeError:
        return False
    return True


# -- canmap.json --------------------------------------------------------------------


def canmap_text(robot: Robot) -> str:
    """The CAN map as JSON text; what is flat stands on one line, so that a diff reads well."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "robot": robot.name,
        "namespace": robot.namespace,
        "buses": [_bus(robot, bus) for bus in robot.buses],
    }
    return _layout(head, 0) + "\n"


def _bus(robot: Robot, bus: Bus) -> dict[str, Any]:
    joints = {joint.name: joint for joint in robot.joints}
    motors = {a.name: (a, joints[a.joint]) for a in robot.actuators}
    frames: dict[str, list[Frame]] = {}
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


def _node(node: Node, motors: Motors, frames: list[Frame]) -> dict[str, Any]:
    return {
        "name": node.name,
        "module": node.module,
        "protocol": node.protocol,
        "id": node.id,
        "id_space": node.id_space,
        "vendor_id": node.vendor_id,
        "product_code": node.product_code,
        "revision_number": node.revision_number,
        "serial": node.serial,
        "device_type": node.device_type,
        "lss": node.lss,
        "heartbeat_timeout": node.heartbeat_timeout,
        "heartbeat_consumer_time": node.heartbeat_consumer_time,
        "bitrates": list(node.bitrates),
        "properties": dict(node.properties),
        "channels": [_channel(node, channel, motors, frames) for channel in node.channels],
        "objects": [
            {
                "name": entry.name,
                "index": entry.index,
                "subindex": entry.subindex,
                "type": entry.type,
                "value": entry.value,
                "access": entry.access,
            }
            for entry in node.objects
        ],
    }


def _channel(node: Node, channel: Channel, motors: Motors, frames: list[Frame]) -> dict[str, Any]:
    plain: dict[str, Any] = {"name": channel.name, "role": channel.role, "actuator": None}
    if channel.actuator is None:
        return plain
    actuator, joint = motors[channel.actuator]
    return {
        **plain,
        "actuator": actuator.name,
        "joint": joint.name,
        "gear_ratio": actuator.gear_ratio,
        "encoder_ppr": actuator.encoder_ppr,
        "motor_max_speed": actuator.motor_max_speed,
        "max_velocity": actuator.max_velocity,
        "max_acceleration": actuator.max_acceleration,
        "lower": joint.lower,
        "upper": joint.upper,
        "signals": [
            {
                "frame": frame.name,
                "signal": signal.name,
                "direction": "report" if frame.producer == node.name else "command",
                "unit": signal.unit,
                "scale": signal.scale,
                "offset": signal.offset,
            }
            for frame in frames
            for signal in frame.signals
            if signal.joint == actuator.joint and signal.unit in JOINT_UNITS
        ],
    }


def _frame(frame: Frame) -> dict[str, Any]:
    return {
        "name": frame.name,
        "cob_id": frame.cob_id,
        "kind": frame.kind,
        "producer": frame.producer,
        "consumers": list(frame.consumers),
        "length": frame.length,
        "period": frame.period,
        "deadline": frame.deadline,
        "minimum_interval": frame.minimum_interval,
        "response_time": frame.response_time,
        "pdo": frame.pdo,
        "mapping": [list(entry) for entry in frame.mapping],
        "synchronous": frame.synchronous,
        "description": frame.description,
        "signals": [_signal(signal) for signal in frame.signals],
    }


def _signal(signal: Signal) -> dict[str, Any]:
    return {
        "name": signal.name,
        "start": signal.start,
        "length": signal.length,
        "signed": signal.signed,
        "scale": signal.scale,
        "offset": signal.offset,
        "unit": signal.unit,
        "minimum": signal.minimum,
        "maximum": signal.maximum,
        "joint": signal.joint,
        "multiplexer": signal.multiplexer,
        "selected_by": list(signal.selected_by),
        "choices": {name: raw for raw, name in signal.choices},
        "description": signal.description,
    }


def _layout(value: Any, depth: int) -> str:
    pad, inner = "  " * depth, "  " * (depth + 1)
    if isinstance(value, dict) and not all(_is_flat(v) for v in value.values()):
        rows = [f"{inner}{_dump(k)}: {_layout(v, depth + 1)}" for k, v in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{pad}}}"
    if isinstance(value, list) and not _is_flat(value):
        rows = [inner + _layout(v, depth + 1) for v in value]
        return "[\n" + ",\n".join(rows) + f"\n{pad}]"
    return _dump(value)


def _is_flat(value: Any) -> bool:
    """Whether the value has no containers in it."""
    if isinstance(value, dict):
        value = list(value.values())
    return not isinstance(value, list) or not any(isinstance(v, dict | list) for v in value)


def _dump(value: Any) -> str:
    return _ENCODER.encode(value)


# -- DBC ----------------------------------------------------------------------------


def dbc_text(bus: Bus) -> str:
    """The bus as a DBC file, written by cantools."""
    db = _cantools_database()
    can = db.can

    class Message(can.Message):  # type: ignore[misc,name-defined]
        """A message that is only written: two thirds of the time go into what that skips."""

        def __deepcopy__(self, memo: dict[int, Any]) -> Message:
            return self  # writing changes names; this one is made for that alone

        def refresh(self, strict: bool | None = None) -> None:
            """No codecs are made, and the layout was checked in the passes."""

    nodes = [can.Node("master", "Master of the bus: the base driver.")] + [
        can.Node(
            node.name,
            _plain(f"{node.module}: {node.protocol}, id {node.id} of {node.id_space}"),
        )
        for node in bus.nodes
    ]
    messages = [
        Message(
            frame.cob_id,
            frame.name,
            frame.length,
            _dbc_signals(db, frame),
            comment=_plain(frame.description) or None,
            senders=[frame.producer],
            # The attribute counts whole milliseconds; the CAN map has the exact period.
            cycle_time=max(1, min(round(frame.period * 1000), 0xFFFF)) if frame.period else None,
            strict=True,
            sort_signals=None,
        )
        for frame in bus.frames
    ]
    dbc = importlib.import_module(f"{can.__name__}.formats.dbc")
    database = can.Database(
        messages=messages,
        nodes=nodes,
        buses=[can.Bus(bus.name, None, bus.bitrate)],
        version="",
        dbc_specifics=dbc.DbcSpecifics(),
        sort_signals=None,
    )
    text: str = database.as_dbc_string(sort_signals=None)
    return text


def _dbc_signals(db: Any, frame: Frame) -> list[Any]:
    selector = next((s.name for s in frame.signals if s.multiplexer), None)
    made = []
    for signal in frame.signals:
        low, high = _limits(signal)
        comment = signal.description
        if signal.joint is not None:
            comment = f"{comment} Joint {signal.joint}.".strip()
        made.append(
            db.can.Signal(
                signal.name,
                signal.start,
                signal.length,
                is_signed=signal.signed,
                conversion=db.conversion.BaseConversion.factory(
                    _number(signal.scale),
                    _number(signal.offset),
                    {raw: _plain(name) for raw, name in signal.choices} or None,
                ),
                minimum=low,
                maximum=high,
                unit=_plain(signal.unit) or None,
                comment=_plain(comment) or None,
                receivers=list(frame.consumers),
                is_multiplexer=signal.multiplexer,
                multiplexer_ids=list(signal.selected_by) or None,
                multiplexer_signal=selector if signal.selected_by else None,
            )
        )
    return made


def _limits(signal: Signal) -> tuple[float | None, float | None]:
    """Both limits or none: a DBC has 0 for one that is missing beside one that is not."""
    if signal.minimum is None and signal.maximum is None:
        return None, None
    first, last = (
        (-1 << signal.length - 1, 1 << signal.length - 1)
        if signal.signed
        else (0, 1 << signal.length)
    )
    ends = sorted(raw * signal.scale + signal.offset for raw in (first, last - 1))
    return (
        ends[0] if signal.minimum is None else signal.minimum,
        ends[1] if signal.maximum is None else signal.maximum,
    )


def _number(value: float) -> float | int:
    return int(value) if value.is_integer() else value


def _plain(text: str) -> str:
    """Text on one line without what ends or escapes a string in a DBC file."""
    return " ".join(text.replace("\\", "/").replace('"', "'").split())


def _cantools_database() -> Any:
    """The package ``cantools.database``, without what ``import cantools`` brings along.

    The top package also imports its bus tester and with it python-can, asyncio
    and ssl: two thirds of the time, and a bus library in a compiler.  So it is
    put in place unexecuted, and runs when someone asks it for something else.
    """
    spec = importlib.util.find_spec("cantools") if "cantools" not in sys.modules else None
    if spec is not None and spec.loader is not None:
        loader, package = spec.loader, importlib.util.module_from_spec(spec)

        def load_the_rest(name: str) -> Any:
            vars(package).pop("__getattr__", None)
            loader.exec_module(package)
            return getattr(package, name)

        vars(package)["__getattr__"] = load_the_rest
        sys.modules["cantools"] = package
    return importlib.import_module("cantools.database")
