"""Checks the CAN buses of a robot: bitrates, heartbeats, bus load and deadlines.

The function ``check_bus`` also runs the checks of the Python module ``id_checks``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.compiler.bus.device_sections import MASTER, Placed
from thorvaldc.compiler.bus.id_checks import (
    check_cob_ids,
    check_ids,
    check_names,
    check_restricted,
)
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model import Bus, FrameDefinition

LOAD_LIMIT, LOAD_WARNING = 0.80, 0.50


def check_bus(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
    """Runs all checks of one CAN bus."""
    same = check_ids(bus, placed, report)
    _check_bitrate(bus, placed, report)
    check_restricted(placed, report)
    check_cob_ids(bus, placed, same, report)
    check_names(bus, placed, report)
    _check_heartbeats(bus, placed, report)
    _check_load(bus, report)
    _check_deadlines(bus, placed, report)


def _check_bitrate(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
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


def _check_deadlines(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
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


def _check_heartbeats(bus: Bus, placed: Sequence[Placed], report: Report) -> None:
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
