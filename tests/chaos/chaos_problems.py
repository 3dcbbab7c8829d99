"""Problems that injected faults cause, as the judge of a mission sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.chaos.invariants import PUSHED, false_reports_notice
from thorvaldc.can.canopen import HEARTBEAT, NMT, RPDO, SYNC, TPDO
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault
from thorvaldc.simulation.bus.promised_times import CREEPING, SECOND_DEVICE, PromisedTimes

MASTER_BUS_OFF = "master_bus_off"
FALSE_REPORTS = "false_reports"
SECOND_MASTER = "second_master"
DISOBEDIENT = ("commands_ignored", "sync_ignored", "nmt_ignored", "frozen_encoder")
"""Kinds of injected faults in which a drive does not do what it receives.

A drive whose encoder is frozen cannot, until it notices that."""
IMPEDING = (
    "babble",
    "bus_off",
    "late_frames",
    "lost_frames",
    "noise",
    "repeated_frames",
    "wrong_bitrate",
    "clone",
    SECOND_MASTER,
    FALSE_REPORTS,
    MASTER_BUS_OFF,
    *DISOBEDIENT,
)
"""Kinds of injected faults in which the drives may not receive what the driver sends."""
LYING = (
    "clone",
    "duplicate_id",
    "encoder_jump",
    FALSE_REPORTS,
    "late_frames",
    "repeated_frames",
    "blocked_motor",
    "frozen_reports",
    PUSHED,
    *DISOBEDIENT,
)
"""Kinds of injected faults that falsify what the motors report, without notice at first."""
EMPTY_BATTERY = "battery_charge of a device"
FASTEST_CONSTANTS = 0.1
"""Period (s) of the report of constants while the driver waits for them."""
OBJECT_WRITTEN = "object_written"
LATCHED = (SECOND_MASTER,)
"""Kinds of problems that must be noticed, even if they were short."""


READING_MARGIN = 0.3
"""s by which a single lost or late SDO response may delay the reading of all objects."""


@dataclass
class Problem:
    """An injected fault in effect.

    - ``since``: time (s) of its start;
    - ``notice``: longest time (s) until the driver notices it, or ``None`` if it need not;
    - ``delay``: time (s) by which frames are late;
    - ``holds``: tells whether a reset of the device has not ended it.
    """

    kind: str
    since: float
    notice: float | None = None
    delay: float = 0.0
    ended: bool = False
    noticed: bool = False
    holds: Callable[[], bool] = lambda: True


def problem_kind(robot: Robot, fault: BusFault) -> str:
    """Returns the kind of problem that an injected fault causes."""
    nodes = {n.name: n for b in robot.buses for n in b.nodes}
    base = (fault.cob_id or 0) & 0x780
    if fault.kind == "forged_frames":
        master = (NMT, SYNC, HEARTBEAT + 0x7F)
        if fault.cob_id in master or base in RPDO:
            return SECOND_MASTER
    if fault.kind in ("babble", "forged_frames") and base in TPDO:
        return FALSE_REPORTS
    if fault.node is not None and not nodes[fault.node].channels:
        return f"{fault.kind} of a device"
    return fault.kind


def notice_time(robot: Robot, kind: str, fault: BusFault) -> float | None:
    """Returns the longest time (s) until the driver notices an injected fault."""
    bus = next(bus for bus in robot.buses if bus.name == fault.bus)
    if kind != FALSE_REPORTS:
        node = next((node for node in bus.nodes if node.name == fault.node), bus.nodes[0])
        times = PromisedTimes(robot, bus, node)
        return {
            "power_cut": times.silence,
            "mute": times.silence,
            "heartbeat_stop": times.beats,
            "wrong_bitrate": times.silence,
            "clone": SECOND_DEVICE,
            SECOND_MASTER: times.silence,
            PUSHED: CREEPING,
            OBJECT_WRITTEN: times.reading + READING_MARGIN,
        }.get(kind)
    drives = {node.name for node in bus.nodes if node.channels}
    reports = {f.cob_id: f.period for f in bus.frames if f.producer in drives and f.period}
    period = reports.get(fault.cob_id or 0)
    if period is None or not fault.period:
        return None  # a single frame, or the report of no motor controller
    if period > fault.period >= FASTEST_CONSTANTS:
        return None  # the driver itself lets the motor controller report constants at this rate
    return false_reports_notice(fault.period)
