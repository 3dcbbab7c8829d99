"""Checks of a bus: ids, COB-IDs over the full expansion, layouts, scalings, load.

Every fault between two parties names both places.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model.robot import Actuator, Bus, Frame, Node, Signal
from thorvaldc.passes.scope import nearest
from thorvaldc.source import node as source

if TYPE_CHECKING:
    from thorvaldc.passes.bus import Device, Wire

# Identifiers that CiA 301 (table "restricted CAN-IDs") keeps for its own services.
RESTRICTED = (
    (0x000, 0x07F),
    (0x101, 0x180),
    (0x581, 0x5FF),
    (0x601, 0x67F),
    (0x6E0, 0x6FF),
    (0x701, 0x7FF),
)
# Services of CANopen that no device needs to declare to have them spoil its frames.
STANDARD = ((0x100, "TIME"), (0x7E4, "LSS response"), (0x7E5, "LSS request"))
LOAD_LIMIT, LOAD_WARNING = 0.80, 0.50
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Placed:
    """A device with its id: ``span`` is the place of its address in the robot's file.

    ``bitrates`` in bit/s that it can do, empty: any; ``module_span`` its `can` section.
    """

    path: str
    bus: str
    span: Span
    node: Node
    frames: tuple[Frame, ...]
    bitrates: tuple[int, ...]
    module_span: Span


# -- wiring -------------------------------------------------------------------------


def check_wiring(devices: Sequence[Device], actuators: Sequence[Actuator], report: Report) -> None:
    """Each channel has one motor at most, each motor one channel, and the roles fit."""
    owners: dict[str, tuple[Device, Wire]] = {}
    for device in devices:
        roles = _roles(device)
        used: dict[str, Wire] = {}
        for wire in device.wires:
            motor = wire.actuator
            if wire.channel not in roles:
                report.add(
                    "channel-unknown",
                    f"`{device.path}` has no channel `{wire.channel}`",
                    wire.span,
                    hint=nearest(wire.channel, list(roles)),
                )
                continue
            if wire.channel in used:
                report.add(
                    "channel-conflict",
                    f"the channel `{wire.channel}` of `{device.path}` has two motors, "
                    f"`{used[wire.channel].actuator.name}` and `{motor.name}`",
                    wire.span,
                    labels=[Label(used[wire.channel].span, "first used here")],
                    hint="a channel drives one motor; take another channel or another controller",
                )
                continue
            used[wire.channel] = wire
            if motor.name in owners:
                other, first = owners[motor.name]
                report.add(
                    "motor-conflict",
                    f"the motor `{motor.name}` is on two channels, `{first.channel}` of "
                    f"`{other.path}` and `{wire.channel}` of `{device.path}`",
                    wire.span,
                    labels=[Label(first.span, "first used here")],
                    hint="give each motor one channel",
                )
                continue
            owners[motor.name] = (device, wire)
            if roles[wire.channel] != motor.role:
                report.add(
                    "channel-role",
                    f"the channel `{wire.channel}` of `{device.path}` is for "
                    f"{roles[wire.channel]}, the motor `{motor.name}` for {motor.role}",
                    wire.span,
                    labels=[Label(motor.origin, "the motor")],
                )
        if roles and not device.wires:
            report.add(
                "controller-without-motor",
                f"`{device.path}` drives no motor",
                device.origin,
                hint="connect one: `channels: {" + next(iter(roles)) + ": <module>.<motor>}`",
            )
    if not any(_roles(device) for device in devices):
        if actuators:
            report.add(
                "robot-without-controller",
                f"none of the {len(actuators)} motors has a controller: "
                "the robot can be simulated, but not driven on a bus",
                actuators[0].origin,
            )
        return
    for motor in actuators:
        if motor.name not in owners:
            report.add(
                "motor-without-controller",
                f"the motor `{motor.name}` is on no controller's channel: "
                "it moves in simulation, but not on the bus",
                motor.origin,
                hint="add a controller, or connect one that has a free channel",
            )


def _roles(device: Device) -> dict[str, str]:
    channels = device.channels
    if channels is None or not isinstance(channels.value, dict):
        return {}
    return {name: device.scope.text(n.get("role")) for name, n in channels.value.items()}


# -- one frame ------------------------------------------------------------------------


def check_layout(
    frame: source.Node,
    length: int,
    signals: Sequence[tuple[Signal, str | None]],
    report: Report,
) -> bool:
    """Whether the signals lie in the frame, apart from each other, and are selected rightly."""
    before = len(report)
    if not 0 <= length <= 8:
        place = frame.get("length") or frame
        report.add(
            "can-frame-length",
            f"the frame has {length} bytes; a CAN frame has 0 to 8 (64 bits)",
            place.span,
        )
        return False
    nodes = frame.get("signals")
    span_of = {
        name: node.where
        for name, node in (
            nodes.value.items() if nodes is not None and isinstance(nodes.value, dict) else ()
        )
    }
    selector: Signal | None = None
    for signal, _ in signals:
        here = span_of[signal.name]
        if signal.length < 1 or signal.start < 0 or signal.start + signal.length > 8 * length:
            report.add(
                "can-signal-bounds",
                f"the signal `{signal.name}` has the bits {signal.start} to "
                f"{signal.start + signal.length - 1}; the frame has 0 to {8 * length - 1}",
                here,
            )
        low, high = raw_range(signal)
        for raw, choice in signal.choices:
            if not low <= raw <= high:
                report.add(
                    "can-choice-range",
                    f"`{choice}` is {raw}; the {signal.length} bits of `{signal.name}` "
                    f"can say {low} to {high}",
                    here,
                )
        if signal.multiplexer and selector is not None:
            report.add(
                "can-multiplexer",
                f"the frame has two multiplexers, `{selector.name}` and `{signal.name}`",
                here,
                labels=[Label(span_of[selector.name], "the first")],
            )
        elif signal.multiplexer:
            selector = signal
    for signal, _ in signals:
        if signal.selected_by and (selector is None or selector is signal):
            report.add(
                "can-multiplexer",
                f"`{signal.name}` is selected by a multiplexer, but the frame has none",
                span_of[signal.name],
                hint="mark the signal that selects with `multiplexer: true`",
            )
        elif selector is not None:
            low, high = raw_range(selector)
            for value in signal.selected_by:
                if not low <= value <= high:
                    report.add(
                        "can-multiplexer",
                        f"`{signal.name}` is selected by {value}; `{selector.name}` "
                        f"can say {low} to {high}",
                        span_of[signal.name],
                    )
    for (first, _), (second, _) in itertools.combinations(signals, 2):
        if _overlap(first, second):
            report.add(
                "can-signal-overlap",
                f"the signals `{first.name}` (bits {first.start} to "
                f"{first.start + first.length - 1}) and `{second.name}` (bits {second.start} to "
                f"{second.start + second.length - 1}) share bits",
                span_of[second.name],
                labels=[Label(span_of[first.name], "first used here")],
            )
    return len(report) == before


def _overlap(a: Signal, b: Signal) -> bool:
    if a.start + a.length <= b.start or b.start + b.length <= a.start:
        return False
    if not a.selected_by or not b.selected_by:
        return True
    return any(value in b.selected_by for value in a.selected_by)


def raw_range(signal: Signal) -> tuple[int, int]:
    """Smallest and largest raw value of the field."""
    if signal.signed:
        return -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    return 0, (1 << signal.length) - 1


def check_scales(
    device: Device, frame: source.Node, signals: Sequence[tuple[Signal, str | None]], report: Report
) -> None:
    """The full speed and the full angle of each joint must fit into its field."""
    wires = {wire.channel: wire for wire in device.wires}
    nodes = frame.get("signals")
    for signal, channel in signals:
        node = nodes.get(signal.name) if nodes is not None else None
        if node is None or (channel is not None and channel not in wires):
            continue
        if signal.scale == 0.0:
            report.add(
                "can-scale",
                f"the scale of `{signal.name}` is 0: every value would be the same",
                (node.get("scale") or node).span,
            )
            continue
        if channel is None:
            continue
        wanted = _joint_range(wires[channel], signal.unit)
        if wanted is None:
            continue
        low, high = _physical_range(signal)
        slack = ROUNDING * max(abs(wanted[0]), abs(wanted[1]))
        if low <= wanted[0] + slack and wanted[1] - slack <= high:
            continue
        field = f"{signal.length} {'signed' if signal.signed else 'unsigned'} bits"
        report.add(
            "can-scale",
            f"`{signal.name}` can say {low:.4g} to {high:.4g} {signal.unit}; the joint "
            f"`{signal.joint}` has {wanted[0]:.4g} to {wanted[1]:.4g} {signal.unit}",
            device.origin,
            labels=[
                Label(node.where, f"{field}, {signal.scale:.4g} {signal.unit} a step"),
                Label(wires[channel].actuator.origin, "the motor"),
            ],
            hint="a wider field, a coarser scale, or lower limits of the motor or joint",
        )


def _joint_range(wire: Wire, unit: str) -> tuple[float, float] | None:
    if unit == "rad/s":
        return -wire.actuator.max_velocity, wire.actuator.max_velocity
    if unit == "rad" and wire.lower is not None and wire.upper is not None:
        return wire.lower, wire.upper
    return None


def _physical_range(signal: Signal) -> tuple[float, float]:
    ends = sorted(raw * signal.scale + signal.offset for raw in raw_range(signal))
    low = ends[0] if signal.minimum is None else max(ends[0], signal.minimum)
    high = ends[1] if signal.maximum is None else min(ends[1], signal.maximum)
    return low, high


# -- one bus --------------------------------------------------------------------------


def check_bus(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
    """Ids, serial numbers, bitrate, COB-IDs and load of a bus."""
    same = _check_ids(bus, placed, report)
    _check_serials(placed, report)
    _check_bitrate(bus, placed, report)
    _check_restricted(placed, report)
    _check_cob_ids(bus, placed, same, report)
    _check_names(bus, placed, report)
    _check_load(bus, report)


def _check_ids(bus: Bus, placed: Sequence[Placed], report: Report) -> dict[str, None]:
    """Report ids that occur twice; returns the nodes at fault, by name."""
    first: dict[tuple[str, int], Placed] = {}
    at_fault: dict[str, None] = {}
    for device in placed:
        key = (device.node.id_space, device.node.id)
        other = first.setdefault(key, device)
        if other is device:
            continue
        at_fault[device.node.name] = None
        report.add(
            "can-id-duplicate",
            f"`{device.path}` has the id {device.node.id} on the bus `{bus.name}`, "
            f"as `{other.path}` has",
            device.span,
            labels=[Label(other.span, "first used here")],
            hint="give each its own id, or leave `can` out to have one chosen",
        )
    return at_fault


def _check_serials(placed: Sequence[Placed], report: Report) -> None:
    first: dict[str, Placed] = {}
    for device in placed:
        serial = device.node.serial
        if serial is None:
            continue
        other = first.setdefault(serial, device)
        if other is not device:
            report.add(
                "can-serial-duplicate",
                f"`{device.path}` has the serial number {serial}, as `{other.path}` has",
                device.span,
                labels=[Label(other.span, "first used here")],
                hint="read each device's own serial number from its label",
            )


def _check_bitrate(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
    for device in placed:
        if device.bitrates and bus.bitrate not in device.bitrates:
            able = ", ".join(f"{rate / 1000:g}" for rate in device.bitrates)
            report.add(
                "can-bitrate",
                f"the bus `{bus.name}` has {bus.bitrate / 1000:g} kbit/s; "
                f"`{device.path}` can do {able} kbit/s",
                bus.origin,
                labels=[
                    Label(device.span, "this device is on it"),
                    Label(device.module_span, "what it can do is said here"),
                ],
            )


def _check_restricted(placed: Sequence[Placed], report: Report) -> None:
    for device in placed:
        for frame in device.frames:
            if frame.kind not in ("pdo", "broadcast", "relay"):
                continue
            for low, high in RESTRICTED:
                if low <= frame.cob_id <= high:
                    report.add(
                        "can-cob-id-restricted",
                        f"the frame `{frame.name}` has the COB-ID {frame.cob_id:#05x}; "
                        f"CANopen keeps {low:#05x} to {high:#05x} for itself",
                        frame.origin,
                        labels=[Label(device.span, "this device has it")],
                    )


@dataclass(frozen=True, slots=True)
class _Claim:
    cob_id: int
    what: str
    owner: str
    span: Span
    device: Placed | None


def _check_cob_ids(
    bus: Bus, placed: Sequence[Placed], skipped: dict[str, None], report: Report
) -> None:
    """No COB-ID may stand for two frames, those of the standard included."""
    first: dict[int, _Claim] = {}
    conflicts: dict[tuple[str, str], list[tuple[_Claim, _Claim]]] = {}
    for claim in _claims(bus, placed, skipped):
        other = first.setdefault(claim.cob_id, claim)
        if other is not claim:
            conflicts.setdefault((other.owner, claim.owner), []).append((other, claim))
    for pairs in conflicts.values():
        other, claim = pairs[0]
        named = ", ".join(f"{c.cob_id:#05x} ({o.what}, {c.what})" for o, c in pairs)
        who = f"`{claim.owner}`"
        if claim.owner == other.owner:
            message = f"two frames of {who} have one COB-ID on the bus `{bus.name}`: {named}"
        else:
            message = (
                f"`{other.owner}` and {who} both have frames with the COB-ID {named} "
                f"on the bus `{bus.name}`"
            )
        report.add(
            "can-cob-id-conflict",
            message,
            claim.span,
            labels=[Label(other.span, "first used here")],
            hint="change the id of one of them, or put one on another bus",
        )


def _claims(bus: Bus, placed: Sequence[Placed], skipped: dict[str, None]) -> Iterator[_Claim]:
    own = {frame.name for device in placed for frame in device.frames}
    canopen = False
    for frame in bus.frames:
        if frame.name not in own:
            canopen = True
            what = {"nmt": "NMT", "sync": "SYNC"}.get(frame.kind, frame.kind)
            yield _Claim(frame.cob_id, what, "master", bus.origin, None)
    if canopen:
        for cob_id, service in STANDARD:
            yield _Claim(cob_id, service, "master", bus.origin, None)
    for device in placed:
        if device.node.name in skipped:
            continue
        prefix = f"{device.node.name}_"
        for frame in device.frames:
            what = frame.name.removeprefix(prefix)
            yield _Claim(frame.cob_id, what, device.path, device.span, device)


def _check_names(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
    """Frames and producers are known by name: in the DBC, to the driver."""
    spans = {frame.name: device.span for device in placed for frame in device.frames}
    seen: dict[str, Frame] = {}
    for device in placed:
        if device.node.name == "master":
            report.add(
                "can-name-conflict",
                "a device named `master` cannot be told from the bus's master",
                device.span,
                hint="give the module another name",
            )
    for frame in bus.frames:
        other = seen.setdefault(frame.name, frame)
        if other is not frame:
            report.add(
                "can-name-conflict",
                f"two frames on the bus `{bus.name}` are named `{frame.name}`",
                spans.get(frame.name, frame.origin),
                labels=[Label(other.origin, "the first")],
                hint="give one of the modules another name",
            )


def frame_bits(length: int) -> int:
    """Bits of a standard frame of ``length`` bytes at worst, stuffing included.

    47 bits of overhead with the interframe space, and a stuff bit for every four
    of the 34 + 8n bits that are stuffed, after the first.
    """
    return 47 + 8 * length + (34 + 8 * length - 1) // 4


def bus_load(bus: Bus) -> float:
    """Share of the bus's time that its periodic frames take at worst."""
    bits = sum(frame_bits(f.length) / f.period for f in bus.frames if f.period)
    return bits / bus.bitrate


def _check_load(bus: Bus, report: Report) -> None:
    load = bus_load(bus)
    if load <= LOAD_WARNING:
        return
    code, limit = ("can-overload", LOAD_LIMIT) if load > LOAD_LIMIT else ("can-load", LOAD_WARNING)
    report.add(
        code,
        f"the periodic frames of the bus `{bus.name}` take {100 * load:.0f} % of its "
        f"{bus.bitrate / 1000:g} kbit/s at worst; the limit is {100 * limit:.0f} %",
        bus.origin,
        hint="a higher bitrate, a lower rate of the driver, or a second bus",
    )
