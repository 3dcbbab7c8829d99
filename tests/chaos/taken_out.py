"""Takes fixes of the driver out again, to show that the tester finds the faults that they prevent.

``python -m tests.chaos --without NAME`` replaces methods of the driver in this process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryLevel, BatterySupervision
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.node_watchdog import ObjectSupervision
from thorvaldc.runtime.can_base.stop_ladder import StopLadder
from thorvaldc.runtime.control_channel import ControlServer
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import MotionPermission
from thorvaldc.runtime.multiplexer import Multiplexer, _Source
from thorvaldc.runtime.pace import Gap, TimeGapRule
from thorvaldc.runtime.service_table import Caller, OwnedStop


def _time_gaps() -> None:
    """A gap in time is no fault, and commands stay valid."""
    _replace(TimeGapRule, "judge", lambda self, elapsed, now=0.0: Gap.NONE)


def _stale_commands() -> None:
    """Requests that have waited in the control channel count."""
    _replace(ControlServer, "_caller", lambda self, sent, client, now: Caller(client.name))


def _closed_connections() -> None:
    """The twists of a closed connection count until their time-out."""
    _replace(Multiplexer, "release", lambda self, owner: None)


def _second_devices() -> None:
    """Neither second devices nor second masters nor false reports are noticed."""
    _replace(BusConnection, "impostor", lambda self: "")


def _stop_locks() -> None:
    """A stop lock does not disarm, and a source with its priority drives through it."""
    initialise = Multiplexer.__init__

    def initialise_below(self: Multiplexer, *inputs: Any) -> None:
        initialise(self, *inputs)
        self._barriers = {name: lock.settings.priority - 0.5 for name, lock in self._locks.items()}

    _replace(Multiplexer, "__init__", initialise_below)
    _replace(Multiplexer, "active_stop_locks", lambda self, now: ())


def _arming() -> None:
    """The robot accepts motion as soon as it is ready."""
    cycle = DrivenRobot.cycle

    def cycle_armed(self: DrivenRobot, now: float) -> Any:
        if self.ready:
            self.driver.permission.armed = True
        return cycle(self, now)

    _replace(DrivenRobot, "cycle", cycle_armed)
    _replace(MotionPermission, "disarm", lambda self, reason="": None)


def _zero_first() -> None:
    """A source that is new or takes over may begin with a motion."""
    _replace(_Source, "await_zero", lambda self, reason: None)


def _owned_sources() -> None:
    """Every connection can publish every source."""
    _replace(_Source, "holder", lambda self, now: "")


def _owned_stops() -> None:
    """Every connection can release every stop."""
    release = OwnedStop.release
    _replace(OwnedStop, "release", lambda self, owner, force=False: release(self, owner, True))


def _replace(owner: type, name: str, replacement: Callable[..., Any]) -> None:
    assert hasattr(owner, name), f"{owner.__name__} has no {name}"
    setattr(owner, name, replacement)


def _batteries() -> None:
    """An empty battery limits and stops nothing."""
    _replace(BatterySupervision, "update", lambda self, now: BatteryLevel.OK)
    _replace(BatterySupervision, "arming_reasons", lambda self, now: iter(()))


def _object_readback() -> None:
    """Objects are compared at the start-up only."""
    _replace(ObjectSupervision, "next_request", lambda self, now: None)


def _motion_supervision() -> None:
    """Motors that do not follow their targets are not noticed while the robot drives or stands."""
    _replace(StopLadder, "problem", lambda self: "")


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
