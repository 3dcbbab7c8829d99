"""Specifications of single simulated devices, without a robot file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from thorvaldc.diagnostics import Span
from thorvaldc.model import Bus, FrameDefinition, Node
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus.simulated_device import DeviceSpecification
from thorvaldc.simulation.bus.wire import Wire

SPAN = Span("robot.yaml", 1, 1, 1, 1)


def specification(
    wire: Wire,
    node_id: int,
    *,
    name: str = "device",
    heartbeat: float = 0.0,
    nonvolatile: Mapping[str, Any] | None = None,
    quirks: Iterable[Quirk] = (),
    robot: Any = None,
    motor: Any = None,
    channels: Any = (),
    properties: Any = (),
    **identity: Any,
) -> DeviceSpecification:
    """Returns the specification of a CANopen node that sends a heartbeat every ``heartbeat`` s."""
    fields = {"vendor_id": None, "serial": None, **identity}
    node = Node(
        name,
        name,
        "",
        node_id,
        "canopen",
        channels=channels,
        properties=properties,
        span=SPAN,
        **fields,
    )
    beat = FrameDefinition(
        "beat", 0x700 + node_id, "heartbeat", name, (), 1, heartbeat, None, (), SPAN
    )
    frames = (beat,) if heartbeat else ()
    bus = Bus("main", wire.bitrate, 0.02, (node,), frames, SPAN)
    return DeviceSpecification(
        robot, bus, node, wire, motor, name, 0, False, nonvolatile or {}, frozenset(quirks)
    )
