"""Checks that the node ids, serial numbers, COB-IDs and names on a CAN bus are unique.

A diagnostic about two CAN devices shows the source spans of both devices.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.can.canopen import TIME_STAMP
from thorvaldc.can.lss import REQUEST as LSS_REQUEST
from thorvaldc.can.lss import RESPONSE as LSS_RESPONSE
from thorvaldc.compiler.bus.device_sections import (
    MASTER,
    Placed,
)
from thorvaldc.compiler.bus.node_objects import serial_number
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import Bus, FrameDefinition

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


def check_ids(bus: Bus, placed: Sequence[Placed], report: Report) -> dict[str, None]:
    """Reports an error if two devices of a CAN bus have the same node id.

    Returns the names of the devices whose node id another device already has.
    """
    first: dict[tuple[str, int], Placed] = {}
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
            labels=[Label(other.span, "first used here")],
            hint="give each device its own id, or leave `can` out for an automatic id",
        )
    return duplicates


def check_serials(placed: Sequence[Placed], report: Report) -> None:
    """Checks that all CAN devices of a vendor have different serial numbers, on all buses.

    Only a device with LSS or with a complete identity (object 0x1018) can report a serial number.
    """
    first: dict[tuple[int | None, int | str], Placed] = {}
    for device in placed:
        serial = device.node.serial
        if serial is None:
            continue
        number = serial_number(serial)
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
                labels=[Label(other.serial_span, "first used here")],
                hint="read each device's own serial number from its label",
            )


def check_restricted(placed: Sequence[Placed], report: Report) -> None:
    """Reports an error for a frame with an identifier that CANopen reserves.

    On a bus without CANopen nodes the modules may use all identifiers.  Relayed frames may not,
    because a foreign device can belong to a CANopen network of its own.
    """
    canopen = any(device.node.is_canopen for device in placed)
    checked = ("pdo", "broadcast", "relay") if canopen else ("relay",)
    for device in placed:
        for frame in device.frames:
            if frame.kind not in checked:
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
    cob_id: int
    what: str
    owner: str
    span: Span
    device: Placed | None


def check_cob_ids(
    bus: Bus, placed: Sequence[Placed], skipped: dict[str, None], report: Report
) -> None:
    """Reports an error if two CAN frames of a bus have the same COB-ID.

    The check includes the CAN frames of the CANopen master and of the CANopen standard services.

    - ``skipped``: names of nodes with a duplicate node id, whose frames are not checked.
    """
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
            yield _Claim(frame.cob_id, what, MASTER, bus.span, None)
    if canopen:
        for cob_id, service in STANDARD:
            yield _Claim(cob_id, service, MASTER, bus.span, None)
    for device in placed:
        if device.node.name in skipped:
            continue
        prefix = f"{device.node.name}_"
        for frame in device.frames:
            what = frame.name.removeprefix(prefix)
            yield _Claim(frame.cob_id, what, device.path, device.span, device)


def check_names(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
    """Checks that the names of nodes and CAN frames on a bus are unique.

    The DBC file and the base driver identify CAN nodes and CAN frames by name.
    """
    spans = {frame.name: device.span for device in placed for frame in device.frames}
    seen: dict[str, FrameDefinition] = {}
    named: dict[str, Placed] = {}
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
