"""From the robot's devices to its buses: ids, frames, signals and their scalings.

What a device says on the bus is data: the `can` section of its module, whose
expressions know the id and the motors on its channels.  The checks of the
result are in `bus_checks`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model.robot import Actuator, Bus, Channel, Frame, Node, Scalar, Signal
from thorvaldc.passes import bus_checks
from thorvaldc.passes.bus_checks import Placed
from thorvaldc.passes.scope import Scope, nearest
from thorvaldc.source import node as source
from thorvaldc.source.units import UnitError, parse_any

MASTER = "master"
CANOPEN = "canopen"
MASTER_ID = 127
MASTER_HEARTBEAT_PERIOD = 0.1
HEARTBEAT_PERIOD = 0.1
NMT_STATES = ((0, "boot_up"), (4, "stopped"), (5, "operational"), (127, "pre_operational"))
NMT_COMMANDS = (
    (1, "start"),
    (2, "stop"),
    (128, "enter_pre_operational"),
    (129, "reset_node"),
    (130, "reset_communication"),
)


@dataclass(frozen=True, slots=True)
class Wire:
    """A motor on a channel.  ``lower`` and ``upper`` (rad) limit its joint, if anything does.

    ``span`` is the place that connects the two.
    """

    channel: str
    actuator: Actuator
    lower: float | None
    upper: float | None
    span: Span


@dataclass(frozen=True, slots=True)
class Device:
    """A module with a `can` section in its place, as the elaboration found it.

    ``can`` and ``channels`` are those sections of the module; ``address`` is what
    the robot says under `can` of the module (an id, ``auto``, a mapping, or
    ``None``); ``origin`` the module's place in the robot's file.
    """

    path: str
    name: str
    can: source.Node
    channels: source.Node | None
    wires: tuple[Wire, ...]
    address: source.Node | None
    scope: Scope
    origin: Span


@dataclass(frozen=True, slots=True)
class BusSpec:
    """A bus as the robot declares it: ``bitrate`` in bit/s."""

    name: str
    bitrate: int
    span: Span


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
    if not specs:
        return ()
    present = [device for device in devices if _is_present(device, report)]
    bus_checks.check_wiring(present, actuators, report)
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


@dataclass(frozen=True, slots=True)
class _Request:
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
        named = scope.with_names({"id": node_id, **_channel_names(device)})
        device_with_names = dataclasses.replace(device, scope=named)
        placed.append(
            Placed(
                device.path,
                request.bus,
                request.span,
                _node(device_with_names, node_id, request),
                tuple(_frames(device_with_names, node_id, sync_period, report)),
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
            hint=nearest(name, known),
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
    found = device.can.get(key)
    if found is None or not isinstance(found.value, tuple) or len(found.value) != 2:
        return default
    low, high = (device.scope.quantity(n, "number") for n in found.value)
    return int(low), int(high)


def _bitrates(device: Device) -> tuple[int, ...]:
    found = device.can.get("bitrates")
    if found is None or not isinstance(found.value, tuple):
        return ()
    return tuple(round(device.scope.quantity(n, "bitrate")) for n in found.value)


def _channel_names(device: Device) -> dict[str, dict[str, float | int]]:
    return {
        wire.channel: {
            "gear_ratio": wire.actuator.gear_ratio,
            "encoder_ppr": wire.actuator.encoder_ppr,
            "motor_max_speed": wire.actuator.motor_max_speed,
            "max_velocity": wire.actuator.max_velocity,
            "lower": -math.pi if wire.lower is None else wire.lower,
            "upper": math.pi if wire.upper is None else wire.upper,
        }
        for wire in device.wires
    }


# -- nodes and frames -----------------------------------------------------------------


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
        int(scope.quantity(vendor, "number")) if vendor is not None else None,
        request.serial,
        tuple(
            Channel(name, scope.text(node.get("role")), wired.get(name))
            for name, node in _entries(device.channels)
        ),
        tuple(
            (name, value)
            for name, node in _entries(can.get("properties"))
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


def _frames(device: Device, node_id: int, sync_period: float, report: Report) -> Iterator[Frame]:
    scope, name = device.scope, device.name
    for key, node in _entries(device.can.get("frames")):
        cob_id = _integer(scope, node.get("cob_id"), -1)
        if not 0 <= cob_id <= 0x7FF:
            place = node.get("cob_id") or node
            report.add(
                "can-cob-id-range",
                f"the frame `{key}` of `{device.path}` has the identifier {cob_id:#x}; "
                "a standard frame has 0x0 to 0x7ff",
                place.span,
                labels=[Label(device.origin, "this device has it")],
            )
            continue
        length = _integer(scope, node.get("length"), 8)
        period = _period(scope, node.get("period"), sync_period)
        signals = tuple(_signals(device, node))
        fits = bus_checks.check_layout(node, length, signals, report)
        kept = tuple(signal for signal, channel in signals if _is_wired(device, channel))
        sends = scope.text(node.get("direction"), "report") == "command"
        if sends and signals and not kept:
            period = None  # nothing to say: the motors that it is for are not there
        deadline = node.get("deadline")
        if fits:
            yield Frame(
                f"{name}_{key}",
                cob_id,
                scope.text(node.get("kind"), "pdo"),
                MASTER if sends else name,
                (name,) if sends else (MASTER,),
                length,
                period,
                scope.quantity(deadline, "time") if deadline is not None else period,
                kept,
                node.where,
                scope.text(node.get("description")),
            )
    yield from _standard_frames(device, node_id)


def _standard_frames(device: Device, node_id: int) -> Iterator[Frame]:
    """The CANopen objects that the device says it has (CiA 301, predefined connection set)."""
    found = device.can.get("canopen")
    if found is None or not isinstance(found.value, tuple):
        return
    name, here = device.name, found.where
    for item in found.value:
        if item.value == "emcy":
            yield Frame(
                f"{name}_emcy",
                0x080 + node_id,
                "emcy",
                name,
                (MASTER,),
                8,
                None,
                None,
                (
                    Signal("error_code", 0, 16),
                    Signal("error_register", 16, 8),
                    Signal("manufacturer_error", 24, 40),
                ),
                here,
                "Emergency: a fault has come or gone.",
            )
        elif item.value == "sdo":
            for way, base, producer, consumer in (
                ("request", 0x600, MASTER, name),
                ("response", 0x580, name, MASTER),
            ):
                yield Frame(
                    f"{name}_sdo_{way}",
                    base + node_id,
                    "sdo",
                    producer,
                    (consumer,),
                    8,
                    None,
                    None,
                    (
                        Signal("command", 0, 8),
                        Signal("index", 8, 16),
                        Signal("subindex", 24, 8),
                        Signal("data", 32, 32),
                    ),
                    here,
                    f"Access to the object dictionary, {way}.",
                )
        elif item.value == "heartbeat":
            period = device.can.get("heartbeat_period")
            every = (
                device.scope.quantity(period, "time") if period is not None else HEARTBEAT_PERIOD
            )
            yield _heartbeat(name, 0x700 + node_id, name, (MASTER,), every, here)


def _heartbeat(
    prefix: str, cob_id: int, producer: str, consumers: tuple[str, ...], period: float, here: Span
) -> Frame:
    return Frame(
        f"{prefix}_heartbeat",
        cob_id,
        "heartbeat",
        producer,
        consumers,
        1,
        period,
        period,
        (Signal("state", 0, 7, choices=NMT_STATES),),
        here,
        "Sign of life with the state of the network management.",
    )


def _signals(device: Device, frame: source.Node) -> Iterator[tuple[Signal, str | None]]:
    """The signals of a frame, each with its channel."""
    scope = device.scope
    joints = {wire.channel: wire.actuator.joint for wire in device.wires}
    for name, node in _entries(frame.get("signals")):
        channel_node = node.get("channel")
        channel = scope.text(channel_node) if channel_node is not None else None
        wired = _is_wired(device, channel)

        def value(key: str, otherwise: float, node: source.Node = node, wired: bool = wired) -> Any:
            # The numbers of a channel without a motor have no meaning and are not evaluated.
            found = node.get(key) if wired else None
            return otherwise if found is None else scope.quantity(found, "number", otherwise)

        signal = Signal(
            name,
            _integer(scope, node.get("start"), 0),
            _integer(scope, node.get("length"), 1),
            scope.boolean(node.get("signed"), False),
            value("scale", 1.0),
            value("offset", 0.0),
            scope.text(node.get("unit")),
            value("minimum", 0.0) if node.get("minimum") is not None else None,
            value("maximum", 0.0) if node.get("maximum") is not None else None,
            joints.get(channel) if channel is not None else None,
            scope.boolean(node.get("multiplexer"), False),
            tuple(_integer(scope, item, 0) for item in _items(node.get("selected_by"))),
            tuple(
                (_integer(scope, raw, 0), choice) for choice, raw in _entries(node.get("choices"))
            ),
            scope.text(node.get("description")),
        )
        yield signal, channel


def _is_wired(device: Device, channel: str | None) -> bool:
    return channel is None or any(wire.channel == channel for wire in device.wires)


def _period(scope: Scope, node: source.Node | None, sync_period: float) -> float | None:
    if node is None or node.value == "on_demand":
        return None
    return sync_period if node.value == "cycle" else scope.quantity(node, "time")


def _integer(scope: Scope, node: source.Node | None, default: int) -> int:
    if node is None:
        return default
    if type(node.value) is int:
        return node.value
    return round(scope.quantity(node, "number", default))


def _entries(node: source.Node | None) -> list[tuple[str, source.Node]]:
    return list(node.value.items()) if node is not None and isinstance(node.value, dict) else []


def _items(node: source.Node | None) -> tuple[source.Node, ...]:
    return node.value if node is not None and isinstance(node.value, tuple) else ()


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
    bus_checks.check_bus(bus, placed, report)
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
    yield _heartbeat(MASTER, 0x700 + MASTER_ID, MASTER, nodes, MASTER_HEARTBEAT_PERIOD, spec.span)
