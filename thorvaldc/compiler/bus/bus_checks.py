"""Checks the CAN buses of a robot: bitrates, heartbeats, bus load, deadlines, ids and wiring.

Node ids, serial numbers, COB-IDs and names are unique on a bus.  A diagnostic about two CAN devices
shows the source spans of both devices.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

from thorvaldc.can.canopen import LSS_REQUEST, LSS_RESPONSE, TIME_STAMP
from thorvaldc.compiler.bus import device_sections as sections
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span, did_you_mean
from thorvaldc.model import Actuator, Bus, FrameDefinition, Robot
from thorvaldc.model.bus import MASTER, key_text
from thorvaldc.model.bus_identity import are_alike

LOAD_LIMIT, LOAD_WARNING = 0.80, 0.50


def check_bus(bus: Bus, placed: Sequence[sections.Placed], report: Report) -> None:
    """Runs all checks of one CAN bus."""
    same = check_ids(bus, placed, report)
    _check_bitrate(bus, placed, report)
    check_restricted(placed, report)
    check_cob_ids(bus, placed, same, report)
    check_names(bus, placed, report)
    _check_heartbeats(bus, placed, report)
    _check_load(bus, report)
    _check_deadlines(bus, placed, report)


def _check_bitrate(bus: Bus, placed: Sequence[sections.Placed], report: Report) -> None:
    """Reports the CAN devices that do not support the bitrate of their bus, in one diagnostic."""
    limited = [device for device in placed if device.node.bitrates]
    unable = [device for device in limited if bus.bitrate not in device.node.bitrates]
    if not unable:
        return
    first = unable[0]
    others = len(unable) - 1
    names = f"`{first.path}`" + (f" and {others} more of its devices" if others else "")
    common = [
        rate
        for rate in first.node.bitrates
        if all(rate in device.node.bitrates for device in limited)
    ]
    rates = ", ".join(f"{rate / 1000:g}" for rate in common)
    bare = "a number without a unit is in bit/s; " if bus.bitrate * 1000 in common else ""
    report.add(
        "can-bitrate",
        f"the bus `{bus.name}` has {bus.bitrate / 1000:g} kbit/s, which {names} cannot use",
        bus.span,
        labels=[
            *(Label(device.span, "this device is on the bus") for device in unable[:2]),
            Label(first.module_span, f"the bitrates of `{first.path}`"),
        ],
        hint=f"{bare}all devices on the bus support {rates} kbit/s"
        if rates
        else "no bitrate suits all devices: put some of them on another bus",
    )


def _check_load(bus: Bus, report: Report) -> None:
    load = bus.load
    if load <= LOAD_WARNING:
        return
    code, limit = ("can-overload", LOAD_LIMIT) if load > LOAD_LIMIT else ("can-load", LOAD_WARNING)
    report.add(
        code,
        f"the periodic frames of the bus `{bus.name}` use up to {100 * load:.0f} % of its "
        f"{bus.bitrate / 1000:g} kbit/s; the limit is {100 * limit:.0f} %",
        bus.span,
        hint="a higher bitrate, a lower rate of the driver, or a second bus",
    )


def late_frames(bus: Bus) -> list[FrameDefinition]:
    """Returns the periodic CAN frames with a worst-case response time longer than the deadline."""
    return [
        frame
        for frame in bus.frames
        if frame.deadline is not None
        and frame.period is not None
        and (frame.response_time is None or frame.response_time > frame.deadline)
    ]


def _check_deadlines(bus: Bus, placed: Sequence[sections.Placed], report: Report) -> None:
    """Checks that every periodic CAN frame meets its deadline in the worst case."""
    owners = {frame.name: device for device in placed for frame in device.frames}
    late = late_frames(bus)
    # A bus load of 0 means that the bus load was not computed.  The function `_check_load` reports
    # an overload of the CAN bus.
    if not late or not 0.0 < bus.load <= LOAD_LIMIT:
        return
    worst = max(late, key=lambda f: math.inf if f.response_time is None else f.response_time)
    named = ", ".join(f"`{frame.name}`" for frame in late[:3])
    if len(late) > 3:
        named += f" and {len(late) - 3} more"
    time = worst.response_time
    takes = f"{time * 1000:.4g} ms" if time is not None else "unlimited time"
    labels = []
    if worst.name in owners:  # no document defines the frames of the master
        labels = [
            Label(worst.span, f"`{worst.name}`"),
            Label(owners[worst.name].span, "of this device"),
        ]
    report.add(
        "can-deadline",
        f"on the bus `{bus.name}` {named} can arrive too late: `{worst.name}` takes up to {takes}, "
        f"its deadline is {(worst.deadline or 0.0) * 1000:.4g} ms",
        bus.span,
        labels=labels,
        hint="a higher bitrate, a lower rate of the driver, or a second bus",
    )


def _check_heartbeats(bus: Bus, placed: Sequence[sections.Placed], report: Report) -> None:
    """Checks the heartbeat time-outs of all CANopen nodes of a bus.

    A heartbeat time-out must be at least two heartbeat periods.  A CiA 402 drive must monitor the
    heartbeat of the CANopen master, so that the drive stops if the master stops.
    """
    periods = [f.period for f in bus.frames if f.kind == "heartbeat" and f.producer == MASTER]
    master_period = periods[0] if periods else None
    for device in placed:
        node = device.node
        if node.is_cia402 and node.heartbeat_consumer_time is None:
            report.add(
                "can-heartbeat-consumer",
                f"`{device.path}` is a CiA 402 drive and does not consume the master's "
                "heartbeat (object 0x1016): it would keep driving after the master stops",
                device.span,
                labels=[Label(device.module_span, "stated here")],
                hint="give its module a `heartbeat_consumer_time`",
            )
        beats = [f.period for f in device.frames if f.kind == "heartbeat" and f.period is not None]
        watched = (
            (node.heartbeat_timeout, beats[0] if beats else None, f"`{device.path}`"),
            (node.heartbeat_consumer_time, master_period, "the master"),
        )
        for timeout, period, producer in watched:
            if timeout is None or period is None or timeout >= 2 * period:
                continue
            watcher = "the master" if producer != "the master" else f"`{device.path}`"
            report.add(
                "can-heartbeat-time",
                f"the heartbeat time-out of {watcher} for {producer} is {timeout * 1000:.6g} ms, "
                f"with a period of {period * 1000:.6g} ms; one late heartbeat would stop the robot",
                device.span,
                labels=[
                    Label(device.module_span, "stated here"),
                    Label(bus.span, "the bus"),
                ],
                hint=f"use {2000 * period:.6g} ms or more",
            )


def check_buses_differ(buses: Sequence[Bus], report: Report) -> None:
    """Warns of two buses that nobody can tell apart if their CAN interfaces are exchanged."""
    for first, second in combinations(buses, 2):
        if not are_alike(first, second):
            continue
        hint = f'give the devices of `{second.name}` other ids, or state `serial: "0x..."`'
        if any(node.automatic for node in second.nodes):
            hint = (
                f"the lock file keeps these ids, which may be in the devices: remove the lines of "
                f"`{second.name}` from it, build, and write the new ids with `thorvaldc can flash`;"
                ' or state `serial: "0x..."` of the devices'
            )
        report.add(
            "can-buses-alike",
            f"the motor controllers of the buses `{first.name}` and `{second.name}` have the same "
            "ids and no serial numbers: if the two are exchanged, the robot drives wrongly",
            second.span,
            labels=[Label(first.span, "the other bus")],
            hint=hint,
        )


# -- unique ids, serial numbers, COB-IDs and names ---------------------------------------

# First and last identifier of each range that CiA 301 reserves (table "restricted CAN-IDs").
RESTRICTED = (
    (0x000, 0x07F),
    (0x101, 0x180),
    (0x581, 0x5FF),
    (0x601, 0x67F),
    (0x6E0, 0x6FF),
    (0x701, 0x7FF),
)
# COB-IDs of the CANopen services that exist on every CANopen bus without a declaration in a module
# document.
STANDARD = (
    (TIME_STAMP, "TIME"),
    (LSS_RESPONSE, "LSS response"),
    (LSS_REQUEST, "LSS request"),
)


def check_ids(bus: Bus, placed: Sequence[sections.Placed], report: Report) -> dict[str, None]:
    """Reports an error if two devices of a CAN bus have the same node id.

    Returns the names of the devices whose node id another device already has.
    """
    first: dict[tuple[str, int], sections.Placed] = {}
    duplicates: dict[str, None] = {}
    for device in placed:
        key = (device.node.id_space, device.node.id)
        if not device.node.id_space:
            continue
        other = first.setdefault(key, device)
        if other is device:
            continue
        duplicates[device.node.name] = None
        report.add(
            "can-id-duplicate",
            f"`{device.path}` and `{other.path}` both have the id "
            f"{device.node.id} on the bus `{bus.name}`",
            device.span,
            labels=[Label(other.span, FIRST_USE)],
            hint="give each device its own id, or leave `can` out for an automatic id",
        )
    return duplicates


def check_serials(placed: Sequence[sections.Placed], report: Report) -> None:
    """Checks that all CAN devices of a vendor have different serial numbers, on all buses.

    Only a device with LSS or with a complete identity (object 0x1018) can report a serial number.
    """
    first: dict[tuple[int | None, int | str], sections.Placed] = {}
    for device in placed:
        serial = device.node.serial
        if serial is None:
            continue
        number = device.node.serial_number
        if not device.node.lss and device.node.product_code is None:
            report.add(
                "can-serial-unreadable",
                f"`{device.path}` has no serial number that can be read over the bus, so that"
                " commissioning would refuse the device",
                device.serial_span,
                labels=[Label(device.module_span, "neither `lss` nor `product_code` here")],
                hint="leave `serial` out; a device without it is commissioned alone on the bus",
            )
            continue
        if device.node.lss and number is None:
            report.add(
                "can-serial-format",
                f"the serial number of `{device.path}` is `{serial}`; LSS identifies a "
                "device by a number of 32 bits",
                device.serial_span,
                labels=[Label(device.module_span, "LSS is stated here")],
                hint='write the number that the device reports, as in "0x12ab34cd"',
            )
        key = (device.node.vendor_id, serial if number is None else number)
        other = first.setdefault(key, device)
        if other is not device:
            report.add(
                "can-serial-duplicate",
                f"`{device.path}` and `{other.path}` both have the serial number {serial}",
                device.serial_span,
                labels=[Label(other.serial_span, FIRST_USE)],
                hint="read each device's own serial number from its label",
            )


def check_restricted(placed: Sequence[sections.Placed], report: Report) -> None:
    """Reports an error for a frame with an identifier that CANopen reserves.

    On a bus without CANopen nodes the modules may use all identifiers.  Relayed frames may not,
    because a foreign device can belong to a CANopen network of its own.
    """
    canopen = any(device.node.is_canopen for device in placed)
    checked = ("pdo", "broadcast", "relay") if canopen else ("relay",)
    for device in placed:
        for frame in device.frames:
            if frame.kind not in checked or frame.extended:
                continue
            for low, high in RESTRICTED:
                if low <= frame.cob_id <= high:
                    report.add(
                        "can-cob-id-restricted",
                        f"the frame `{frame.name}` has the COB-ID {frame.cob_id:#05x}; "
                        f"CANopen reserves {low:#05x} to {high:#05x}",
                        frame.span,
                        labels=[Label(device.span, "of this device")],
                    )


class _Claim(NamedTuple):
    key: int
    what: str
    owner: str
    span: Span
    device: sections.Placed | None


def check_cob_ids(
    bus: Bus, placed: Sequence[sections.Placed], skipped: dict[str, None], report: Report
) -> None:
    """Reports an error if two CAN frames of a bus have the same COB-ID with equally many bits.

    The check includes the CAN frames of the CANopen master and of the CANopen standard services.

    - ``skipped``: names of nodes with a duplicate node id, whose frames are not checked.
    """
    first: dict[int, _Claim] = {}
    conflicts: dict[tuple[str, str], list[tuple[_Claim, _Claim]]] = {}
    for claim in _claims(bus, placed, skipped):
        other = first.setdefault(claim.key, claim)
        if other is not claim:
            conflicts.setdefault((other.owner, claim.owner), []).append((other, claim))
    for pairs in conflicts.values():
        other, claim = pairs[0]
        named = ", ".join(f"{key_text(c.key)} ({o.what}, {c.what})" for o, c in pairs)
        labels = [Label(other.span, FIRST_USE)] if other.device is not None else []
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


def _claims(
    bus: Bus, placed: Sequence[sections.Placed], skipped: dict[str, None]
) -> Iterator[_Claim]:
    own = {frame.name for device in placed for frame in device.frames}
    canopen = False
    for frame in bus.frames:
        if frame.name not in own:
            canopen = True
            what = {"nmt": "NMT", "sync": "SYNC"}.get(frame.kind, frame.kind)
            yield _Claim(frame.key, what, MASTER, bus.span, None)
    if canopen:
        for cob_id, service in STANDARD:
            yield _Claim(cob_id, service, MASTER, bus.span, None)
    for device in placed:
        if device.node.name in skipped:
            continue
        prefix = f"{device.node.name}_"
        for frame in device.frames:
            what = frame.name.removeprefix(prefix)
            yield _Claim(frame.key, what, device.path, device.span, device)


def check_names(bus: Bus, placed: Sequence[sections.Placed], report: Report) -> None:
    """Checks that the names of nodes and CAN frames on a bus are unique.

    The DBC file and the base driver identify CAN nodes and CAN frames by name.
    """
    spans = {frame.name: device.span for device in placed for frame in device.frames}
    seen: dict[str, FrameDefinition] = {}
    named: dict[str, sections.Placed] = {}
    for device in placed:
        twin = named.setdefault(device.node.name, device)
        if twin is not device:
            report.add(
                "can-name-conflict",
                f"`{twin.path}` and `{device.path}` are both named `{device.node.name}` on the "
                f"bus `{bus.name}`",
                device.span,
                labels=[Label(twin.span, "the first")],
                hint="give one of them another name",
            )
        if device.node.name == MASTER:
            report.add(
                "can-name-conflict",
                f"a device has the name `{MASTER}`, which is that of the bus's master",
                device.span,
                hint="give the module another name",
            )
    for frame in bus.frames:
        other = seen.setdefault(frame.name, frame)
        if other is not frame:
            report.add(
                "can-name-conflict",
                f"two frames on the bus `{bus.name}` are named `{frame.name}`",
                spans.get(frame.name, frame.span),
                labels=[Label(other.span, "the first")],
                hint="give one of the modules another name",
            )


# -- motors on the channels of motor controllers -----------------------------------------

_SIDES = (("left", "right", 1), ("front", "rear", 0))
"""Words in the names of channels, and the coordinate that is greater for the first of them."""
_SIDE_TOLERANCE = 1e-3
"""Difference of positions (m) below which two wheels are on the same side."""


def check_wiring(
    devices: Sequence[sections.Device], actuators: Sequence[Actuator], report: Report
) -> None:
    """Checks the connections between motors and motor controllers.

    A motor can be connected to only one motor controller channel, and the channel must have the
    role of the motor.  Reports motors without a motor controller, and motor controllers without a
    motor.
    """
    owners: dict[str, tuple[sections.Device, sections.Wire]] = {}
    for device in devices:
        roles = _roles(device)
        for wire in device.wires:
            motor = wire.actuator
            if wire.channel not in roles:
                report.add(
                    "channel-unknown",
                    f"`{device.path}` has no channel `{wire.channel}`",
                    wire.span,
                    hint=did_you_mean(wire.channel, roles, sections.listed(roles)),
                )
                continue
            if motor.name in owners:
                other, first = owners[motor.name]
                report.add(
                    "motor-conflict",
                    f"the motor `{motor.name}` is on two channels, `{first.channel}` of "
                    f"`{other.path}` and `{wire.channel}` of `{device.path}`",
                    wire.span,
                    labels=[Label(first.span, FIRST_USE)],
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
                    labels=[Label(motor.span, "the motor")],
                )
        if roles and not device.wires:
            report.add(
                "controller-without-motor",
                f"`{device.path}` drives no motor",
                device.span,
                hint="connect one: `channels: {" + next(iter(roles)) + ": <module>.<motor>}`",
            )
    if not any(_roles(device) for device in devices):
        if actuators:
            report.add(
                "robot-without-controller",
                f"none of the {len(actuators)} motors has a controller: "
                "the robot can be simulated, but not driven on a bus",
                actuators[0].span,
            )
        return
    for motor in actuators:
        if motor.name not in owners:
            report.add(
                "motor-without-controller",
                f"the motor `{motor.name}` is on no controller's channel: "
                "it moves in simulation, but not on the bus",
                motor.span,
                hint="add a controller, or connect one that has a free channel",
            )


def check_sides(robot: Robot, root: Instance, report: Report) -> None:
    """Checks that channels named after two sides drive wheels on these sides.

    ``root``: root of the tree of module instances, with the entries of the channels.
    """
    motors = {(motor.node, motor.channel): motor for motor in robot.actuators}
    wheels = {wheel.spin_joint: wheel.contact_point for wheel in robot.wheels}
    for leaf in root.leaves():
        node = name_prefix(leaf.path)
        for channel, entry in leaf.wiring.items():
            for positive, negative, axis in _SIDES:
                other = channel.replace(positive, negative)
                pair = [motors.get((node, name)) for name in (channel, other)]
                here, there = (wheels.get(m.joint) if m is not None else None for m in pair)
                if here is None or there is None or here[axis] >= there[axis] - _SIDE_TOLERANCE:
                    continue
                report.add(
                    "channel-side",
                    f"the channel `{channel}` of `{leaf.path}` drives the wheel on the {negative} "
                    f"side, and `{other}` that on the {positive} side",
                    entry.where,
                    labels=[Label(leaf.wiring[other].where, "the other channel")],
                    hint="swap the two motors, also on the real controller",
                )


def _roles(device: sections.Device) -> dict[str, str]:
    return {n: device.scope.text(node.get("role")) for n, node in entries(device.channels).items()}
