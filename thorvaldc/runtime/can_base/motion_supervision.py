"""Compares the measured motion of the motors of a controller with the commanded motion.

The supervision is the same for every kind of motor controller.  A driver can only make it stricter
(``MotorController.follow_limits``).  What is compared depends on what the motors are commanded to:

    command        a motor obeys if
    FOLLOW         a wheel has one of the target speeds of the last half second, within a tolerance,
                   or brakes to rest from the speed with which it rolled without torque;
                   a steering joint is at its target angle or turns towards it;
                   a wheel that is commanded to stand does not travel;
                   its reports change when its target does
    HOME           the wheels stand as above; steering joints search their home positions
    QUICK_STOP     it slows down at least as fast as this line, and then stands:

                   speed |v0 ______  grace: reaction time + GRACE
                         |         \\
                         |          \\  STOP_SHARE of the deceleration of the motor
                         |           \\________________ SPEED_DEVIATION, then REST_TRAVEL
                         +-----------------------------> time

    OFF            it stands; a motor that turns without torque is pushed by hand, or rolls
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from thorvaldc.runtime.can_base.motor_controller import STANDING, Axis, FollowLimits

LIMITS = FollowLimits()
REST_TRAVEL = 0.5
"""Longest travel (rad) of a wheel that is commanded to stand."""
GRACE = 0.15
"""Time (s) after the reaction time of a stop in which a motor need not slow down yet."""
STOP_SHARE = 0.5
"""Share of the deceleration of a motor with which it must slow down at least in a quick stop.

A loaded robot brakes more slowly, and more slowly still down a slope."""
LONGEST_STEP = 0.1
"""Longest time (s) between two control cycles in which a wheel counts as travelling."""
TOO_FAST_TIME = 0.15
"""Time (s) for which a motor may be faster than promised in a stop."""
SHORTEST = 0.1
"""Shortest time (s) of a deviation that counts."""
SETTLED = 0.1
"""Time (s) at rest after which a motor stands."""
REPORT_AGE = 0.2
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

    def __init__(self, axis: Axis, limits: FollowLimits) -> None:
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
            approaches = axis.velocity * error > 0.0 and abs(axis.velocity) >= STANDING
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
        if not self.stands_by_command or abs(axis.velocity) <= STANDING:
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

    def __init__(self, axis: Axis) -> None:
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
        if speed > STANDING:
            self._turns_since = now
        rate = STOP_SHARE * axis.actuator.max_acceleration
        allowed = self._speed - rate * max(now - self._falls_at, 0.0)
        if allowed < LIMITS.speed:
            # The motor should stand by now.
            self._travel = self._travel + speed * dt if speed > STANDING else 0.0
        too_fast = speed > max(allowed, LIMITS.speed) and now > self._falls_at
        self._too_fast_since = min(self._too_fast_since, axis.time) if too_fast else math.inf


class MotionSupervision:
    """Compares the measured motion of the motors of one controller with their commands.

    The supervision starts anew whenever the command changes.
    """

    def __init__(self, axes: Sequence[Axis], limits: FollowLimits = LIMITS) -> None:
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
            if follows and not (homing and follower.axis.steering):
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

    def turning(self) -> Iterator[Axis]:
        """Yields the motors that turn, by their newest reports."""
        return (s.axis for s in self._stoppers if abs(s.axis.velocity) > STANDING)
