"""Takes fixes of the driver out again, to show that the tester finds the faults that they prevent.

``python -m tests.chaos --without NAME`` replaces methods of the driver in this process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.chaos import invariants
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryLevel, BatterySupervision
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.node_watchdog import ObjectSupervision
from thorvaldc.runtime.can_base.stop_ladder import StopLadder
from thorvaldc.runtime.control_channel import ControlServer
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.motion_supervision import Follower
from thorvaldc.runtime.pace import Gap, TimeGapRule
from thorvaldc.runtime.permission import DONE, MotionPermission, Permission, Rules, Step
from thorvaldc.runtime.service_table import Caller


def _time_gaps() -> None:
    """A gap in time is no fault, and commands stay valid."""
    _replace(TimeGapRule, "judge", lambda self, elapsed, now=0.0: Gap.NONE)


def _stale_commands() -> None:
    """Requests that have waited in the control channel count."""
    _replace(ControlServer, "_caller", lambda self, sent, client, now: Caller(client.name))


def _closed_connections() -> None:
    """The twists of a closed connection count until their time-out."""
    _replace(Rules, "end_program", lambda self, value, owner: (value, DONE))


def _second_devices() -> None:
    """Neither second devices nor second masters nor false reports are noticed."""
    _replace(BusConnection, "impostor", lambda self: "")


def _stop_locks() -> None:
    """A stop lock neither disarms nor blocks a source."""
    active_locks = Rules.active_locks

    def other_active_locks(
        self: Rules, value: Permission, now: float
    ) -> tuple[tuple[int, ...], float]:
        active, _ = active_locks(self, value, now)
        active = tuple(k for k in active if not self.locks[k].is_stop_lock)
        return active, max((self.locks[k].priority for k in active), default=-1.0)

    set_lock = Rules.set_lock

    def only_set_lock(self: Rules, value: Permission, *lock: Any) -> Step:
        changed, answer = set_lock(self, value, *lock)
        return value._replace(locks=changed.locks), answer

    _replace(Rules, "active_locks", other_active_locks)
    _replace(Rules, "set_lock", only_set_lock)


def _arming() -> None:
    """The robot accepts motion as soon as it is ready."""
    cycle = DrivenRobot.cycle

    def cycle_armed(self: DrivenRobot, now: float) -> Any:
        if self.ready:
            _arm(self.driver.permission)
        return cycle(self, now)

    _replace(DrivenRobot, "cycle", cycle_armed)
    for event in ("disarm", "hold"):
        _replace(Rules, event, lambda self, value, reason="": (value, DONE))


def _arm(permission: MotionPermission) -> None:
    permission.value = permission.value._replace(armed=True)


def _zero_first() -> None:
    """A source may begin with a motion, and resume one."""
    _replace(Rules, "begins", lambda self, source, twist: True)
    _replace(Rules, "resumes", lambda self, source: True)


def _owned_sources() -> None:
    """Every connection can publish every source."""
    publish = Rules.publish

    def publish_any(self: Rules, value: Permission, *twist: Any) -> Step:
        return publish(self, value, *twist[:3], "anybody")

    _replace(Rules, "publish", publish_any)


def _owned_stops() -> None:
    """Every connection can release every stop."""
    set_lock = Rules.set_lock

    def set_by_force(self: Rules, value: Permission, *lock: Any) -> Step:
        return set_lock(self, value, *lock[:4], True)

    _replace(Rules, "set_lock", set_by_force)


def _replace(owner: type, name: str, replacement: Callable[..., Any]) -> None:
    assert hasattr(owner, name), f"{owner.__name__} has no {name}"
    setattr(owner, name, replacement)
    invariants.rules_are_whole = False


def _batteries() -> None:
    """An empty battery limits and stops nothing."""
    _replace(BatterySupervision, "update", lambda self, now: BatteryLevel.OK)
    _replace(BatterySupervision, "arming_reasons", lambda self, now: iter(()))


def _object_readback() -> None:
    """Objects are compared at the start-up only."""
    _replace(ObjectSupervision, "next_request", lambda self, now: None)


def _motion_supervision() -> None:
    """Motors that do not follow their targets are not noticed while the robot drives or stands."""
    _replace(Follower, "problem", lambda self, now: "")


def _stop_ladder() -> None:
    """No motor controller climbs beyond the quick stop."""
    _replace(StopLadder, "_climb", lambda self, climber, now: None)


def _starving() -> None:
    """The heartbeat of the driver feeds the watchdogs of drives that do not obey."""
    enter = StopLadder._enter

    def enter_fed(self: StopLadder, climber: Any, rung: Any, now: float) -> None:
        enter(self, climber, rung, now)
        climber.connection.starved = False

    _replace(StopLadder, "_enter", enter_fed)


TAKEN_OUT: dict[str, Callable[[], None]] = {
    "time_gaps": _time_gaps,
    "stale_commands": _stale_commands,
    "closed_connections": _closed_connections,
    "second_devices": _second_devices,
    "stop_locks": _stop_locks,
    "arming": _arming,
    "zero_first": _zero_first,
    "owned_sources": _owned_sources,
    "owned_stops": _owned_stops,
    "batteries": _batteries,
    "object_readback": _object_readback,
    "motion_supervision": _motion_supervision,
    "stop_ladder": _stop_ladder,
    "starving": _starving,
}
"""Fixes that can be taken out, by name."""
