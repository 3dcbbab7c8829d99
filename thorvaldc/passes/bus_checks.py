"""Checks of a bus: ids, COB-IDs over the full expansion, layouts, scalings, load.

Every fault between two parties names both places.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.robot import Actuator, Bus, Frame, Node
from thorvaldc.passes.bus_device import MASTER, Device, Wire, entries, listed

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


class Placed(NamedTuple):
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
        for wire in device.wires:
            motor = wire.actuator
            if wire.channel not in roles:
                report.add(
                    "channel-unknown",
                    f"`{device.path}` has no channel `{wire.channel}`",
                    wire.span,
                    hint=did_you_mean(wire.channel, roles, listed(roles)),
                )
                continue
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
    return {n: device.scope.text(node.get("role")) for n, node in entries(device.channels)}


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
    """One fault for the bus, whatever the number of devices that cannot follow it."""
    choosy = [device for device in placed if device.bitrates]
    unable = [device for device in choosy if bus.bitrate not in device.bitrates]
    if not unable:
        return
    first = unable[0]
    others = len(unable) - 1
    who = f"`{first.path}`" + (f" and {others} more of its devices" if others else "")
    common = [rate for rate in first.bitrates if all(rate in device.bitrates for device in choosy)]
    rates = ", ".join(f"{rate / 1000:g}" for rate in common)
    report.add(
        "can-bitrate",
        f"the bus `{bus.name}` has {bus.bitrate / 1000:g} kbit/s, which {who} cannot do",
        bus.origin,
        labels=[
            *(Label(device.span, "this device is on it") for device in unable[:2]),
            Label(first.module_span, f"what `{first.path}` can do is said here"),
        ],
        hint=f"all devices on it can do {rates} kbit/s"
        if rates
        else "no bitrate suits all devices on it: put some on another bus",
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


class _Claim(NamedTuple):
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
        labels = [Label(other.span, "first used here")] if other.device is not None else []
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
            labels=labels,
            hint="change the id of one of them, or put one on another bus"
            if labels
            else "give it another id; this one is for the bus's master, the base driver",
        )


def _claims(bus: Bus, placed: Sequence[Placed], skipped: dict[str, None]) -> Iterator[_Claim]:
    own = {frame.name for device in placed for frame in device.frames}
    canopen = False
    for frame in bus.frames:
        if frame.name not in own:
            canopen = True
            what = {"nmt": "NMT", "sync": "SYNC"}.get(frame.kind, frame.kind)
            yield _Claim(frame.cob_id, what, MASTER, bus.origin, None)
    if canopen:
        for cob_id, service in STANDARD:
            yield _Claim(cob_id, service, MASTER, bus.origin, None)
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
        if device.node.name == MASTER:
            report.add(
                "can-name-conflict",
                f"a device named `{MASTER}` cannot be told from the bus's master",
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
