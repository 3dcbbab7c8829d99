"""From the robot's devices to its buses: ids, frames, signals and their scalings.

What a device says on the bus is data: the `can` section of its module, whose
expressions know the id and the motors on its channels.  The checks of the
result are in `bus_checks`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.robot import Actuator, Bus, Channel, Frame, Node, Scalar, Signal
from thorvaldc.passes.bus_checks import Placed, check_bus, check_wiring
from thorvaldc.passes.bus_device import (
    CANOPEN,
    MASTER,
    BusSpec,
    Device,
    Wire,
    entries,
    integer,
    items,
    listed,
)
from thorvaldc.passes.bus_frames import channel_names, frames_of, heartbeat
from thorvaldc.passes.scope import Scope
from thorvaldc.source import node as source
from thorvaldc.source.units import UnitError, parse_any

__all__ = ["BusSpec", "Device", "Wire", "build_buses", "connect_actuators"]

MASTER_ID = 127
MASTER_HEARTBEAT_PERIOD = 0.1  # s
NMT_COMMANDS = (
    (1, "start"),
    (2, "stop"),
    (128, "enter_pre_operational"),
    (129, "reset_node"),
    (130, "reset_communication"),
)


def build_buses(
    devices: Sequence[Device],
    specs: Sequence[BusSpec],
    actuators: Sequence[Actuator],
    sync_period: float,
    report: Report,
) -> tuple[Bus, ...]:
    """The buses with their nodes, frames and signals, checked.

    ``specs`` in file order; a device that names no bus is on the first.
    ``sync_period`` in s is the control cycle.  A robot without devices has no buses.
    """
    for spec in specs:
        if spec.bitrate <= 0:
            report.add(
                "can-bitrate",
                f"the bus `{spec.name}` has {spec.bitrate} bit/s; a bitrate is positive",
                spec.span,
                hint="write it as in `500 kbit/s`",
            )
    if not specs or any(spec.bitrate <= 0 for spec in specs):
        return ()
    present = [device for device in devices if _is_present(device, report)]
    check_wiring(present, actuators, report)
    placed = _place(present, specs, sync_period, report)
    if not placed:
        return ()
    return tuple(
        _build_bus(spec, [p for p in placed if p.bus == spec.name], sync_period, report)
        for spec in specs
    )


def connect_actuators(actuators: Sequence[Actuator], buses: Sequence[Bus]) -> tuple[Actuator, ...]:
    """The actuators with ``node`` and ``channel`` set to the controller that drives each."""
    drives = {
        channel.actuator: (node.name, channel.name)
        for bus in buses
        for node in bus.nodes
        for channel in node.channels
        if channel.actuator is not None
    }
    return tuple(
        dataclasses.replace(a, node=drives[a.name][0], channel=drives[a.name][1])
        if a.name in drives
        else a
        for a in actuators
    )


def _is_present(device: Device, report: Report) -> bool:
    """Whether there is a device at all: an empty battery enclosure has none."""
    present = device.scope.boolean(device.can.get("when"), True)
    if not present and device.address is not None:
        report.add(
            "can-address-unused",
            f"`{device.path}` has an address, but there is nothing on the bus in it",
            device.address.where,
            hint="leave `can` out, or change the parameters so that the device is there",
        )
    return present


# -- addresses ----------------------------------------------------------------------


class _Request(NamedTuple):
    """What the robot says of a device's address; ``id`` is ``None`` for auto."""

    bus: str
    id: int | None
    serial: str | None
    span: Span


def _place(
    devices: Sequence[Device], specs: Sequence[BusSpec], sync_period: float, report: Report
) -> list[Placed]:
    requests = [(device, _request(device, specs, report)) for device in devices]
    taken: dict[tuple[str, str], dict[int, None]] = {}
    for device, request in requests:
        if request.id is not None:
            taken.setdefault((request.bus, _id_space(device)), {})[request.id] = None
    placed = []
    for device, request in requests:
        scope = device.scope
        low, high = _id_range(device, "ids", (1, MASTER_ID))
        node_id = request.id
        if node_id is None:
            first, last = _id_range(device, "auto_ids", (low, high))
            used = taken.setdefault((request.bus, _id_space(device)), {})
            node_id = next((i for i in range(first, last + 1) if i not in used), None)
            if node_id is None:
                report.add(
                    "can-ids-exhausted",
                    f"no id is left for `{device.path}`: {first} to {last} are all taken",
                    request.span,
                    hint=f"give it one of {low} to {high} with `can: ...`, or use another bus",
                )
                continue
            used[node_id] = None
        elif not low <= node_id <= high:
            report.add(
                "can-id-range",
                f"`{device.path}` has the id {node_id}; this device can have {low} to {high}",
                request.span,
            )
            continue
        named = scope.with_names({"id": node_id, **channel_names(device)})
        device_with_names = device._replace(scope=named)
        placed.append(
            Placed(
                device.path,
                request.bus,
                request.span,
                _node(device_with_names, node_id, request),
                tuple(frames_of(device_with_names, node_id, sync_period, report)),
                _bitrates(device),
                device.can.where,
            )
        )
    return placed


def _request(device: Device, specs: Sequence[BusSpec], report: Report) -> _Request:
    default = specs[0].name
    address = device.address
    if address is None:
        return _Request(default, None, None, device.origin)
    if not isinstance(address.value, dict):
        node_id = device.scope.evaluate(address)
        return _Request(default, node_id if type(node_id) is int else None, None, address.span)
    bus, id_node, serial = address.get("bus"), address.get("id"), address.get("serial")
    name = default if bus is None else str(bus.value)
    known = [spec.name for spec in specs]
    if bus is not None and name not in known:
        report.add(
            "can-bus-unknown",
            f"there is no bus `{name}`",
            bus.span,
            hint=did_you_mean(name, known, listed(known)),
        )
        name = default
    return _Request(
        name,
        id_node.value if id_node is not None and type(id_node.value) is int else None,
        str(serial.value) if serial is not None else None,
        id_node.span if id_node is not None else address.span,
    )


def _id_space(device: Device) -> str:
    return device.scope.text(device.can.get("id_space"), CANOPEN)


def _id_range(device: Device, key: str, default: tuple[int, int]) -> tuple[int, int]:
    ends = [integer(device.scope, node, 0) for node in items(device.can.get(key))]
    return (ends[0], ends[1]) if len(ends) == 2 else default


def _bitrates(device: Device) -> tuple[int, ...]:
    found = items(device.can.get("bitrates"))
    return tuple(round(device.scope.quantity(node, "bitrate")) for node in found)


def _node(device: Device, node_id: int, request: _Request) -> Node:
    scope, can = device.scope, device.can
    wired = {wire.channel: wire.actuator.name for wire in reversed(device.wires)}
    vendor = can.get("vendor_id")
    return Node(
        device.name,
        device.path,
        scope.text(can.get("protocol")),
        node_id,
        _id_space(device),
        integer(scope, vendor, 0) if vendor is not None else None,
        request.serial,
        tuple(
            Channel(name, scope.text(node.get("role")), wired.get(name))
            for name, node in entries(device.channels)
        ),
        tuple(
            (name, value)
            for name, node in entries(can.get("properties"))
            if (value := _scalar(scope, node)) is not None
        ),
        device.origin,
    )


def _scalar(scope: Scope, node: source.Node) -> Scalar | None:
    """A property: text with a unit in SI, other text as it is."""
    value = scope.evaluate(node)
    if isinstance(value, str) and not node.quoted:
        try:
            return parse_any(value)
        except UnitError:
            return value
    return value if isinstance(value, bool | int | float | str) else None


# -- the bus ------------------------------------------------------------------------


def _build_bus(spec: BusSpec, placed: Sequence[Placed], sync_period: float, report: Report) -> Bus:
    frames = list(_master_frames(spec, placed, sync_period))
    for device in placed:
        frames.extend(device.frames)
    bus = Bus(
        spec.name,
        spec.bitrate,
        sync_period,
        tuple(device.node for device in placed),
        tuple(frames),
        spec.span,
    )
    check_bus(bus, placed, report)
    return bus


def _master_frames(spec: BusSpec, placed: Sequence[Placed], sync_period: float) -> Iterator[Frame]:
    """What the master says to all, where there are CANopen nodes to hear it."""
    nodes = tuple(d.node.name for d in placed if d.node.id_space == CANOPEN)
    if not nodes:
        return
    yield Frame(
        "nmt",
        0x000,
        "nmt",
        MASTER,
        nodes,
        2,
        None,
        None,
        (Signal("nmt_command", 0, 8, choices=NMT_COMMANDS), Signal("nmt_node", 8, 8)),
        spec.span,
        "Network management: change the state of one node, or of all (0).",
    )
    yield Frame(
        "sync",
        0x080,
        "sync",
        MASTER,
        nodes,
        0,
        sync_period,
        sync_period,
        (),
        spec.span,
        "The control cycle's beat, after its commands.",
    )
    yield heartbeat(MASTER, 0x700 + MASTER_ID, MASTER, nodes, MASTER_HEARTBEAT_PERIOD, spec.span)
