"""Reads the foreign CAN devices from a robot file.

A foreign device is a device on a CAN bus of the robot that is not a module of the robot.
The base driver relays only the CAN frames that the robot file declares for a foreign device.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from thorvaldc.compiler.bus.device_frames import HEARTBEAT_PERIOD, minimum_interval, standard_frames
from thorvaldc.compiler.bus.device_sections import MASTER, BusSpec, Placed, entries
from thorvaldc.compiler.bus.node_ids import bus_name
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source import node as source
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import FrameDefinition, Node
from thorvaldc.model.bus import CANOPEN

PROTOCOL = "foreign"


def foreign_devices(
    section: source.Node | None, specs: Sequence[BusSpec], report: Report
) -> list[Placed]:
    """Returns the foreign CAN devices of a robot with the CAN frames that the base driver relays.

    - ``section``: section `foreign_devices` of the robot file.
    """
    scope = Scope(None, {}, Library(), report, None)
    devices = []
    for name, device in entries(section):
        id_node = device.get("id")
        node_id = id_node.value if id_node is not None and type(id_node.value) is int else None
        services = device.get("canopen")
        if services is not None and services.value and node_id is None:
            report.add(
                "missing-key",
                f"`{name}` has CANopen services, but no node id for their frames",
                services.where,
                hint="add `id: ...`",
            )
            services = None
        frames = [
            *_relayed(name, device, scope, report),
            *standard_frames(name, node_id or 0, services, HEARTBEAT_PERIOD),
        ]
        span = id_node.span if id_node is not None else device.where
        devices.append(
            Placed(
                name,
                bus_name(device.get("bus"), specs, report),
                span,
                span,
                _node(name, node_id, device.where),
                tuple(frames),
                device.where,
            )
        )
    return devices


def _node(name: str, node_id: int | None, span: Span) -> Node:
    id_space = CANOPEN if node_id is not None else ""
    return Node(name, "", PROTOCOL, node_id or 0, id_space, None, None, (), (), span)


def _relayed(
    name: str, device: source.Node, scope: Scope, report: Report
) -> Iterator[FrameDefinition]:
    for key, node in entries(device.get("frames")):
        cob_id, length = node.get("cob_id"), node.get("length")
        if cob_id is None or type(cob_id.value) is not int:
            continue  # the schema check reports a missing or invalid COB-ID
        to_device = scope.text(node.get("direction")) == "command"
        yield FrameDefinition(
            f"{name}_{key}",
            cob_id.value,
            "relay",
            MASTER if to_device else name,
            (name,) if to_device else (MASTER,),
            length.value if length is not None and type(length.value) is int else 8,
            None,
            None,
            (),
            node.where,
            scope.text(node.get("description")),
            minimum_interval(scope, node, report),
        )
