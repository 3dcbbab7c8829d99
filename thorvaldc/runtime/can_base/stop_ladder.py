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
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from thorvaldc.can.canopen import NmtCommand
from thorvaldc.model import Robot, stopping
from thorvaldc.model.statics.slope import holds_without_torque
from thorvaldc.runtime.can_base import motor_controller
from thorvaldc.runtime.can_base.base_fault import Cause, Fault
from thorvaldc.runtime.can_base.bus_connection import BusConnection


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

    def __init__(
        self, connection: BusConnection, controller: motor_controller.MotorController
    ) -> None:
        self.connection = connection
        self.controller = controller
        self.supervision = MotionSupervision(controller.axes, controller.follow_limits)
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


class StopLadder:
    """Supervises the motion of all motors, and stops those that do not obey.

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

    # -- while the robot follows commands ----------------------------------------------------------

    def follow(self, now: float, powered: bool, homing: bool) -> None:
        """Compares the motion of all motors with their targets; called in each control cycle.

        - ``powered``: ``True`` if the motors are commanded to follow their targets, or to home;
        - ``homing``: ``True`` if the steering joints search their home positions.
        """
        if self._stopping:
            self._stopping = False
            for climber in self._climbers:
                climber.rung = Rung.QUICK_STOP
                climber.connection.starved = False
        for climber in self._climbers:
            controller = climber.controller
            follows = powered and (not controller.is_off if homing else controller.follows)
            climber.supervision.update(follows, now, homing)
            controller.warning = ""

    def problem(self) -> Fault | None:
        """Returns the fault of a motor that does not follow its target, or ``None``."""
        for climber in self._climbers:
            if problems := climber.supervision.problems:
                return Fault(Cause.MOTION, ", ".join(problems), climber.controller.node.name)
        return None

    # -- while the robot stops ---------------------------------------------------------------------

    def stop(self, now: float, commanded: bool) -> None:
        """Lets each controller climb that does not stop; called in each control cycle of a stop.

        ``commanded``: ``False`` if the motors have not been commanded since the start-up.
        """
        begins, self._stopping = not self._stopping, True
        for climber in self._climbers:
            if begins:
                # A motor without torque may be pushed by hand from the start.
                climber.has_stood = climber.controller.is_off or not commanded
                self._enter(climber, Rung.QUICK_STOP, now)
            climber.obedience = climber.supervision.obedience(now)
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
        controller, obedience = climber.controller, climber.obedience
        controller.warning = ""
        if climber.is_at_end:
            return
        if climber.rung is Rung.TORQUE_OFF and climber.connection.watchdog.has_booted(
            controller, climber.since
        ):
            self._enter(climber, Rung.RELEASED, now)
            return
        if obedience is Obedience.STANDS:
            climber.has_stood = True
        elif obedience is not Obedience.UNKNOWN and (
            controller.power_loss or (climber.has_stood and controller.is_off)
        ):
            names = ", ".join(axis.channel for axis in climber.supervision.turning())
            if names:
                controller.warning = f"{names} turns without torque; is the robot pushed?"
            return
        failed = obedience is Obedience.DISOBEYS
        if obedience is Obedience.UNKNOWN and not climber.has_stood:
            failed = now - climber.since > self._patience(climber.rung)
        if failed and not self._would_release_others(climber):
            self._enter(climber, self._next(climber), now)
        elif obedience is not Obedience.STANDS:
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
        turns = self.holds_without_torque or any(climber.supervision.turning())
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
        climber.supervision.begin_stop(now, reaction)
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


# -- compares the measured motion of motors with the commanded motion ---------------------------
#
# The supervision is the same for every kind of motor controller.  A driver can only make it
# stricter (``MotorController.follow_limits``).  What is compared depends on what the motors are
# commanded to:
#
#     command        a motor obeys if
#     FOLLOW         a wheel has one of the target speeds of the last half second, within a
#                    tolerance, or brakes to rest from the speed with which it rolled without
#                    torque;
#                    a steering joint is at its target angle or turns towards it;
#                    a wheel that is commanded to stand does not travel;
#                    its reports change when its target does
#     HOME           the wheels stand as above; steering joints search their home positions
#     QUICK_STOP     it slows down at least as fast as this line, and then stands:
#
#                    speed |v0 ______  grace: reaction time + GRACE
#                          |         \
#                          |          \  STOP_SHARE of the deceleration of the motor
#                          |           \________________ SPEED_DEVIATION, then REST_TRAVEL
#                          +-----------------------------> time
#
#     OFF            it stands; a motor that turns without torque is pushed by hand, or rolls

LIMITS: Final = motor_controller.FollowLimits()
REST_TRAVEL: Final = 0.5
"""Longest travel (rad) of a wheel that is commanded to stand."""
GRACE: Final = 0.15
"""Time (s) after the reaction time of a stop in which a motor need not slow down yet."""
STOP_SHARE: Final = 0.5
"""Share of the deceleration of a motor with which it must slow down at least in a quick stop.

A loaded robot brakes more slowly, and more slowly still down a slope."""
LONGEST_STEP: Final = 0.1
"""Longest time (s) between two control cycles in which a wheel counts as travelling."""
TOO_FAST_TIME: Final = 0.15
"""Time (s) for which a motor may be faster than promised in a stop."""
SHORTEST: Final = 0.1
"""Shortest time (s) of a deviation that counts."""
SETTLED: Final = 0.1
"""Time (s) at rest after which a motor stands."""
REPORT_AGE: Final = 0.2
"""Age (s) of the newest report of a motor above which its motion is unknown."""


class Obedience(enum.Enum):
    """Answer of the motors of a controller to the command to stop.

    - ``STANDS``: all motors stand;
    - ``SLOWS``: all motors slow down as promised;
    - ``DISOBEYS``: a motor does not slow down as promised, or turns again after it stood;
    - ``UNKNOWN``: the reports of a motor are missing.
    """

    STANDS = "stands"
    SLOWS = "slows"
    DISOBEYS = "disobeys"
    UNKNOWN = "unknown"


class _Target(NamedTuple):
    time: float
    value: float


class _Follower:
    """Judges whether one motor follows its target."""

    def __init__(self, axis: motor_controller.Axis, limits: motor_controller.FollowLimits) -> None:
        self.axis = axis
        self.limits = limits
        self.forget()

    def forget(self) -> None:
        """Forgets all earlier targets and deviations."""
        self.deviating_since = math.inf
        """Start time (s) of the present deviation."""
        self.frozen_since = math.inf
        """Time (s) from which the target changes, but the reports do not."""
        self._targets: deque[_Target] = deque()
        self._reported: tuple[float, float] = (math.nan, math.nan)
        self._target_then = math.nan
        """Target at the newest change of the reports."""
        self._excess = 0.0
        """Travel (rad) of the present deviation beyond all recent targets."""
        self._travel = 0.0
        """Travel (rad) since the wheel is commanded to stand."""
        self._rolling = math.nan
        """Speed (rad/s) that a wheel may still have because it rolled at first."""
        self._updated_at = math.inf

    @property
    def stands_by_command(self) -> bool:
        """``True`` if a wheel was commanded to stand for the last ``limits.time`` seconds."""
        return not self.axis.steering and not any(value for _, value in self._targets)

    @property
    def problem(self) -> str:
        axis, limits = self.axis, self.limits
        lasts = axis.time - self.deviating_since
        deviates = lasts > (limits.time if axis.steering else limits.speed_time)
        deviates |= lasts > SHORTEST and self._excess > limits.excess
        if deviates or abs(self._travel) > REST_TRAVEL:
            if self.stands_by_command:
                return f"the {axis.channel} turns, although it is commanded to stand"
            return f"the {axis.channel} does not follow its target"
        if axis.time - self.frozen_since > limits.time:
            return f"the {axis.channel} does not follow its target, and its reports do not change"
        return ""

    def update(self, now: float, target: float) -> None:
        """``target``: commanded wheel speed (rad/s) or steering angle (rad)."""
        axis, limits = self.axis, self.limits
        if axis.steering:
            error = target - axis.position
            approaches = (
                axis.velocity * error > 0.0 and abs(axis.velocity) >= motor_controller.STANDING
            )
            deviates = abs(error) > limits.angle and not approaches
        else:
            deviates = self._update_wheel(now, target)
        self.deviating_since = min(self.deviating_since, axis.time) if deviates else math.inf
        reported = (axis.position, axis.velocity)
        if reported != self._reported:
            self._reported, self._target_then = reported, target
        tolerance = limits.angle if axis.steering else limits.speed
        is_frozen = abs(target - self._target_then) > tolerance
        self.frozen_since = min(self.frozen_since, axis.time) if is_frozen else math.inf

    def _update_wheel(self, now: float, target: float) -> bool:
        axis, targets = self.axis, self._targets
        dt = min(max(now - self._updated_at, 0.0), LONGEST_STEP)
        self._updated_at = now
        targets.append(_Target(now, target))
        if math.isnan(self._rolling):
            self._rolling = axis.velocity if target == 0.0 else 0.0
        if self._rolling:  # a wheel that rolled when its motor got torque brakes first
            braked = STOP_SHARE * axis.actuator.max_acceleration * dt
            self._rolling = math.copysign(max(abs(self._rolling) - braked, 0.0), self._rolling)
            targets.append(_Target(now, self._rolling))
        while targets[0].time < now - self.limits.time:
            targets.popleft()
        if not self.stands_by_command or abs(axis.velocity) <= motor_controller.STANDING:
            self._travel = 0.0
        else:
            self._travel += axis.velocity * dt
        excess = self._excess_of(axis.velocity)
        self._excess = self._excess + excess * dt if excess > 0.0 else 0.0
        return excess > 0.0

    def _excess_of(self, speed: float) -> float:
        """Returns by how much (rad/s) ``speed`` is beyond the recent targets and a tolerance."""
        limits = self.limits
        lowest = min(value for _, value in self._targets)
        highest = max(value for _, value in self._targets)
        lowest -= max(limits.share * abs(lowest), limits.speed)
        highest += max(limits.share * abs(highest), limits.speed)
        return max(speed - highest, lowest - speed, 0.0)


class _Stopper:
    """Judges whether one motor slows down as promised after the command to stop."""

    def __init__(self, axis: motor_controller.Axis) -> None:
        self.axis = axis
        self.begin(0.0, 0.0)

    def begin(self, now: float, reaction: float) -> None:
        """The motor must slow down from its present speed after ``reaction`` (s)."""
        speed = abs(self.axis.velocity)
        self._speed = speed if math.isfinite(speed) else self.axis.actuator.max_velocity
        self._falls_at = now + reaction + GRACE
        self._too_fast_since = math.inf
        self._turns_since = now
        self._travel = 0.0
        self._updated_at = now

    def stands(self, now: float) -> bool:
        return now - self._turns_since >= SETTLED

    @property
    def disobeys(self) -> bool:
        too_fast = self.axis.time - self._too_fast_since > TOO_FAST_TIME
        return too_fast or self._travel > REST_TRAVEL

    def update(self, now: float) -> None:
        axis, dt = self.axis, min(now - self._updated_at, LONGEST_STEP)
        self._updated_at = now
        speed = abs(axis.velocity)
        if speed > motor_controller.STANDING:
            self._turns_since = now
        rate = STOP_SHARE * axis.actuator.max_acceleration
        allowed = self._speed - rate * max(now - self._falls_at, 0.0)
        if allowed < LIMITS.speed:
            # The motor should stand by now.
            self._travel = self._travel + speed * dt if speed > motor_controller.STANDING else 0.0
        too_fast = speed > max(allowed, LIMITS.speed) and now > self._falls_at
        self._too_fast_since = min(self._too_fast_since, axis.time) if too_fast else math.inf


class MotionSupervision:
    """Compares the measured motion of the motors of one controller with their commands.

    The supervision starts anew whenever the command changes.
    """

    def __init__(
        self, axes: Sequence[motor_controller.Axis], limits: motor_controller.FollowLimits = LIMITS
    ) -> None:
        """``limits``: limits of the driver, of which only the stricter ones count."""
        limits = LIMITS.stricter(limits)
        self._followers = [_Follower(axis, limits) for axis in axes]
        self._stoppers = [_Stopper(axis) for axis in axes]

    # -- while the motors follow their targets -----------------------------------------------------

    @property
    def deviates(self) -> bool:
        """``True`` if a motor deviates now, even if not long enough for a problem."""
        return any(follower.deviating_since < math.inf for follower in self._followers)

    @property
    def problems(self) -> list[str]:
        """A message for each motor that has deviated from its target for too long."""
        return [follower.problem for follower in self._followers if follower.problem]

    def update(self, follows: bool, now: float, homing: bool = False) -> None:
        """Compares targets and measurements; called in each control cycle.

        - ``follows``: ``True`` if the motors are powered and commanded to follow their targets;
        - ``homing``: ``True`` if the steering joints search their home positions.
        """
        for follower in self._followers:
            if follows and follower.axis.powered and not (homing and follower.axis.steering):
                follower.update(now, 0.0 if homing else follower.axis.target)
            else:
                follower.forget()

    # -- after the command to stop -----------------------------------------------------------------

    def begin_stop(self, now: float, reaction: float) -> None:
        """The motors were commanded to stop at ``now`` (s), and react within ``reaction`` (s)."""
        for stopper in self._stoppers:
            stopper.begin(now, reaction)

    def obedience(self, now: float) -> Obedience:
        """Judges the stop; called once in each control cycle after ``begin_stop``."""
        for stopper in self._stoppers:
            stopper.update(now)
        if any(now - stopper.axis.time > REPORT_AGE for stopper in self._stoppers):
            return Obedience.UNKNOWN
        if any(stopper.disobeys for stopper in self._stoppers):
            return Obedience.DISOBEYS
        stands = all(stopper.stands(now) for stopper in self._stoppers)
        return Obedience.STANDS if stands else Obedience.SLOWS

    def turning(self) -> Iterator[motor_controller.Axis]:
        """Yields the motors that turn, by their newest reports."""
        return (s.axis for s in self._stoppers if abs(s.axis.velocity) > motor_controller.STANDING)


RESET_TIME: Final = 2.0
"""Time (s) in which a node sends its boot-up message after an NMT reset."""
NMT_REPEAT: Final = 0.2
"""Time (s) after which an NMT stop is sent again, because a frame may be lost."""
NO_WATCHDOG: Final = 1.0
"""Time (s) without commands after which a controller without a known watchdog is judged."""
