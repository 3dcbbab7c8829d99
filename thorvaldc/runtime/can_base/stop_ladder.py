"""Stops motors that do not obey, by means that need less and less of the motor controller.

The ladder is the same for every kind of motor controller.  Each controller climbs alone:

      driving          COMMANDED STOP   wheel speed 0 by the ramp of the base driver
                            |           the motion does not follow the command, or another fault,
                            |           a safety stop, or the end of the program
                            v
    +-----------------  QUICK STOP      the steepest ramp of the controller
    | stands                |           it does not slow down as promised, or `reaction` + GRACE
    v                       |           passed without reports
  HELD  <-----------+       v
    | turns again,  +--  NMT STOP       the node leaves OPERATIONAL (object 0x6007 stops it)
    | with torque   |       |           the same, but a controller without reports gets `stop`
    +--> next rung  |       v
                    +--  STARVE         no heartbeat, no SYNC and no command on the whole bus, so
                    |       |           that the watchdog of the controller ends the motion
                    |       |           after `watchdog` + `stop`
                    |       v
                    +--  TORQUE OFF     NMT reset of the node, which starts without torque;
                    |       |           skipped where nothing shows that the motor turns, unless
                    |       |           the robot stands without torque
                    |       |           boot-up message ------------------------> RELEASED
                    |       v           after RESET_TIME
                    +--  CUT POWER      the wheel is named: a person must cut the power

The times are those of the robot (``StopTimes``).  A motor that obeys is never asked to climb.  The
bus of a drive whose watchdog only takes the torque is silenced when its obedient motors stand.
Only ``reset`` leads back down.

``STARVE`` and all later rungs silence the bus, so that nothing feeds the watchdogs of its
controllers any more.  Only the NMT reset is still sent.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from thorvaldc.can.canopen import NmtCommand
from thorvaldc.model import Robot, stopping
from thorvaldc.model.statics.slope import holds_without_torque
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.motor_controller import MotorController
from thorvaldc.runtime.motion_supervision import (
    GRACE,
    STANDING,
    STOP_SHARE,
    Axis,
    Obedience,
    Stopper,
    obedience,
)


class Rung(enum.IntEnum):
    """Rungs of the ladder, see the module."""

    QUICK_STOP = 0
    NMT_STOP = 1
    STARVE = 2
    TORQUE_OFF = 3
    RELEASED = 4
    CUT_POWER = 5


class StopTimes(NamedTuple):
    """Times (s) of the ladder of a robot, see the module.

    - ``reaction``: longest time until a motor reacts to a command;
    - ``stop``: longest time of a quick stop from the highest speed, with ``reaction`` and GRACE;
    - ``watchdog``: longest time until the watchdog of a controller acts.
    """

    reaction: float
    stop: float
    watchdog: float

    @classmethod
    def of(cls, robot: Robot) -> StopTimes:
        settings = [robot.driver, *(p.driver for p in robot.parameter_sets)]
        driven = stopping.driven_wheels(robot.wheels, robot.actuators)
        ramp = max(stopping.quick_stop_ramp(driven, choice).time for choice in settings)
        reaction = max(
            stopping.reaction_times(robot, choice)[stopping.DETECTED_FAULT] for choice in settings
        )
        nodes = [n for bus in robot.buses for n in bus.nodes if any(c.actuator for c in n.channels)]
        known = [time for node in nodes if (time := stopping.watchdog_time(node)) is not None]
        watchdog = max(known) if len(known) == len(nodes) else max([*known, NO_WATCHDOG])
        return cls(reaction, reaction + GRACE + ramp, watchdog)

    @property
    def longest(self) -> float:
        """Longest time (s) from the command to stop until the last rung.

        A motor that barely slows down as promised stays ``1 / STOP_SHARE`` times as long on the
        first rung.
        """
        return self.stop / STOP_SHARE + 2.0 * self.stop + self.watchdog + RESET_TIME


class _Climber:
    """A motor controller on the ladder."""

    def __init__(self, connection: BusConnection, controller: MotorController) -> None:
        self.connection = connection
        self.controller = controller
        self.stoppers = [Stopper(axis) for axis in controller.axes]
        self.rung = Rung.QUICK_STOP
        self.since = 0.0
        """Time (s) at which the controller reached its rung."""
        self.has_stood = False
        """``True`` if the motors have stood at least once since the command to stop."""
        self.obedience = Obedience.UNKNOWN
        self.verdict = ""
        """Message for the operator about motors that do not obey, or an empty text."""
        self.sent_at = -math.inf
        """Time (s) of the newest NMT command of the rung."""

    @property
    def is_at_end(self) -> bool:
        return self.rung in (Rung.RELEASED, Rung.CUT_POWER)

    @property
    def stands(self) -> bool:
        """``True`` if all motors stand, or stood when their reports ended."""
        if self.obedience is Obedience.UNKNOWN:
            return self.has_stood
        return self.obedience is Obedience.STANDS

    @property
    def is_off(self) -> bool:
        """``True`` if all motors have no torque, or if no command reaches them any more."""
        return self.controller.is_off or self.connection.starved

    def turning(self) -> Iterator[Axis]:
        """Yields the motors that turn, by their newest reports."""
        return (axis for axis in self.controller.axes if abs(axis.velocity) > STANDING)


class StopLadder:
    """Stops the motors that do not obey.

    ``holds_without_torque``: ``True`` if the robot stays at rest on its design slope when all
    motors lose their torque.
    """

    def __init__(self, robot: Robot, connections: Sequence[BusConnection]) -> None:
        self.robot = robot
        self.holds_without_torque = holds_without_torque(robot)
        self.times = StopTimes.of(robot)
        self._climbers = [
            _Climber(c, controller) for c in connections for controller in c.controllers
        ]
        self._stopping = False

    def leave(self) -> None:
        """Ends the stop: the motors follow their targets again."""
        if self._stopping:
            self._stopping = False
            for climber in self._climbers:
                climber.rung = Rung.QUICK_STOP
                climber.connection.starved = False
                climber.controller.warning = ""

    def stop(self, now: float, commanded: bool) -> None:
        """Lets each controller climb that does not stop; called in each control cycle of a stop.

        ``commanded``: ``False`` if the motors have not been commanded since the start-up.
        """
        begins, self._stopping = not self._stopping, True
        for climber in self._climbers:
            if begins:
                # A motor without torque may be pushed by hand from the start.
                climber.has_stood = climber.controller.is_off or not commanded
                for axis in climber.controller.axes:
                    axis.follows = False
                self._enter(climber, Rung.QUICK_STOP, now)
            climber.obedience = obedience(climber.stoppers, now)
            self._climb(climber, now)

    @property
    def stands(self) -> bool:
        """``True`` if all motors stand, except those that the ladder could not stop."""
        return self._stopping and all(c.stands or c.is_at_end for c in self._climbers)

    @property
    def is_finished(self) -> bool:
        """``True`` if all motors stand without torque, except those that could not be stopped."""
        return self.stands and all(c.is_off or c.is_at_end for c in self._climbers)

    @property
    def verdict(self) -> str:
        """Message for the operator about the motors that do not obey, or an empty text.

        It names each wheel that was seen to disobey, and each one at the end of the ladder.
        """
        return "; ".join(climber.verdict for climber in self._climbers if climber.verdict)

    def _climb(self, climber: _Climber, now: float) -> None:
        controller, answer = climber.controller, climber.obedience
        controller.warning = ""
        if climber.is_at_end:
            return
        if climber.rung is Rung.TORQUE_OFF and climber.connection.watchdog.has_booted(
            controller, climber.since
        ):
            self._enter(climber, Rung.RELEASED, now)
            return
        if answer is Obedience.STANDS:
            climber.has_stood = True
        elif answer is not Obedience.UNKNOWN and (
            controller.power_loss or (climber.has_stood and controller.is_off)
        ):
            names = ", ".join(axis.channel for axis in climber.turning())
            if names:
                controller.warning = f"{names} turns without torque; is the robot pushed?"
            return
        failed = answer is Obedience.DISOBEYS
        if answer is Obedience.UNKNOWN and not climber.has_stood:
            failed = now - climber.since > self._patience(climber.rung)
        if failed and not self._would_release_others(climber):
            self._enter(climber, self._next(climber), now)
        elif answer is not Obedience.STANDS:
            self._repeat(climber, now)

    def _would_release_others(self, climber: _Climber) -> bool:
        """Checks whether the next rung would take the torque from a wheel that slows down.

        Silence on the bus reaches all its controllers.  One whose watchdog only takes the torque
        must stand before; it is on the ladder too, so that it stands or climbs in a bounded time.
        """
        if self._next(climber) < Rung.STARVE or climber.connection.starved:
            return False
        return any(
            other.obedience is Obedience.SLOWS and other.controller.node.watchdog_coasts
            for other in self._climbers
            if other is not climber and other.connection is climber.connection
        )

    def _patience(self, rung: Rung) -> float:
        """Returns the time (s) after which a controller without reports climbs."""
        times = self.times
        if rung is Rung.QUICK_STOP:
            return times.reaction + GRACE
        if rung is Rung.TORQUE_OFF:
            return RESET_TIME
        return times.stop + (times.watchdog if rung is Rung.STARVE else 0.0)

    def _next(self, climber: _Climber) -> Rung:
        is_canopen = climber.controller.node.is_canopen
        if climber.rung is Rung.QUICK_STOP:
            return Rung.NMT_STOP if is_canopen else Rung.STARVE
        if climber.rung is Rung.NMT_STOP:
            return Rung.STARVE
        turns = self.holds_without_torque or any(climber.turning())
        if climber.rung is Rung.STARVE and is_canopen and turns:
            return Rung.TORQUE_OFF
        return Rung.CUT_POWER

    def _enter(self, climber: _Climber, rung: Rung, now: float) -> None:
        climber.rung, climber.since, climber.sent_at = rung, now, -math.inf
        if rung is Rung.QUICK_STOP:
            climber.verdict = ""
        elif not climber.verdict and (climber.is_at_end or climber.obedience is Obedience.DISOBEYS):
            climber.verdict = self._verdict_on(climber)
        reaction = self.times.reaction
        if rung > Rung.QUICK_STOP and climber.obedience is Obedience.DISOBEYS:
            climber.controller.disobeyed = True
        if rung is Rung.STARVE:
            reaction += self.times.watchdog
        if rung >= Rung.STARVE:
            climber.connection.starved = True
        if rung is Rung.TORQUE_OFF:
            reaction += RESET_TIME
            climber.connection.queue_nmt(NmtCommand.RESET_NODE, [climber.controller])
        for stopper in climber.stoppers:
            stopper.begin(now, reaction)
        self._repeat(climber, now)

    def _repeat(self, climber: _Climber, now: float) -> None:
        if climber.rung is Rung.NMT_STOP and now - climber.sent_at > NMT_REPEAT:
            climber.sent_at = now
            climber.connection.queue_nmt(NmtCommand.STOP, [climber.controller])

    # -- texts -------------------------------------------------------------------------------------

    def _verdict_on(self, climber: _Climber) -> str:
        axes = climber.controller.axes
        names = sorted({self.robot.wheels[axis.wheel].name for axis in axes})
        if climber.obedience is Obedience.UNKNOWN:
            motion = "may turn, because its controller reports nothing"
        else:
            axis = max(axes, key=lambda axis: abs(axis.velocity))
            radius = self.robot.wheels[axis.wheel].radius
            steers = f"steers with {abs(axis.velocity):.2f} rad/s"
            turns = f"turns with {abs(axis.velocity) * radius:.2f} m/s"
            motion = f"{steers if axis.steering else turns} and does not obey"
        wheels = f"{' and '.join(names)} ({climber.controller.node.name})"
        return f"cut the power: wheel {wheels} {motion}"


RESET_TIME: Final = 2.0
"""Time (s) in which a node sends its boot-up message after an NMT reset."""
NMT_REPEAT: Final = 0.2
"""Time (s) after which an NMT stop is sent again, because a frame may be lost."""
NO_WATCHDOG: Final = 1.0
"""Time (s) without commands after which a controller without a known watchdog is judged."""
