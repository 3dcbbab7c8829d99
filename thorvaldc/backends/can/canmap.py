"""The file `can/canmap.json`, the normative description of the robot's CAN buses.

The page docs/canmap.md describes the format of canmap.json.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable
from typing import Any

from thorvaldc.model import Actuator, Bus, Channel, FrameDefinition, Joint, Node, Robot, Signal

FORMAT = "thorvaldc-canmap"
VERSION = 3
JOINT_UNITS = ("rad", "rad/s")
Motors = dict[str, tuple[Actuator, Joint]]
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


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


def _node(node: Node, motors: Motors, frames: list[FrameDefinition]) -> dict[str, Any]:
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
        "command_watchdog": node.command_watchdog,
        "watchdog_coasts": node.watchdog_coasts,
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


def _frame(frame: FrameDefinition) -> dict[str, Any]:
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
        "floating_point": signal.floating_point,
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
