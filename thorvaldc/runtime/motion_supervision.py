r"""The measured motion of each motor beside its commands: one rule for every kind of base.

What is compared depends on what the motors are commanded to:

    command        a motor obeys if
    FOLLOW         a wheel has one of the target speeds of the last half second, within a
                   tolerance, or brakes to rest from the speed with which it rolled without
                   torque;
                   a steering joint is at its target angle or turns towards it, and does not
                   swing about another angle;
                   a wheel that is commanded to stand does not travel;
                   its reports change when its target does, and no faster than a wheel can
    HOME           the wheels stand as above; steering joints search their home positions
    QUICK_STOP     it slows down at least as fast as this line, and then stands:

                   speed |v0 ______  grace: reaction time + GRACE
                         |         \
                         |          \  STOP_SHARE of the deceleration of the motor
                         |           \________________ STOPPED, then REST_TRAVEL
                         +-----------------------------> time

    OFF            it stands; a motor that turns without torque is pushed by hand, or rolls

``BaseDriver`` compares the motors that follow, in every cycle: while the robot drives, stops or
stands, armed or not.  What a base does about a motor that does not obey is its own matter: those on
a bus have the rungs of ``stop_ladder``, those behind topics end all motion.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

from thorvaldc.model import Actuator

STANDING: Final = 0.02
"""Speed (rad/s) below which a wheel or a steering joint counts as standing."""
JUMP: Final = 0.1
"""Largest difference (rad) of two reported steering angles that the motion cannot explain."""
JUMP_SPEED: Final = 1.5
"""Largest speed of a steering joint, as a multiple of the top speed of its motor."""
JUMP_TIME: Final = 0.04
"""Shortest time (s) of motion between two reports, because adapters delay single frames."""
LEAP: Final = 3.0
"""Largest change of a reported wheel speed that a motion explains, beyond ``FollowLimits.speed``:
multiple of the change by the acceleration of the motor.  Kerbs and rough ground stay below 1."""
LEAPS: Final = 5.0
"""Number of larger changes, less LEAP_DECAY for each second, that single wrong reports explain."""
LEAP_DECAY: Final = 2.0
"""Number of such changes that a second makes up for, 1/s."""
REST_TRAVEL: Final = 0.5
"""Longest travel (rad) of a wheel that is commanded to stand."""
GRACE: Final = 0.15
"""Time (s) after the reaction time of a stop in which a motor need not slow down yet."""
STOP_SHARE: Final = 0.5
"""Share of the deceleration of a motor with which it must slow down at least in a quick stop.

A loaded robot brakes more slowly, and more slowly still down a slope."""
STOPPED: Final = 0.3
"""Speed (rad/s) below which a motor need not slow down any more in a stop."""
SWING: Final = 0.5
"""Travel (rad) of a steering joint away from a target that does not change, less SWING_DECAY for
each second, that is no swing.  Only the travel far from the target counts, for a bump turns a
wheel."""
SWING_DECAY: Final = 0.1
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


class FollowLimits(NamedTuple):
    """Limits of the deviation of a motor from its target, see ``Follower``.

    - ``time``: time (s) for which a motor may deviate from its target, longer than ramps and
      delays;
    - ``speed_time``: time (s) for which a wheel speed may match no target of the last ``time``
      seconds;
    - ``excess``: travel (rad) by which a wheel may meanwhile exceed, or fall behind, all these
      targets; a kerb turns a wheel by up to 0.15 rad;
    - ``share``, ``speed``: largest deviation of a wheel speed: share of the target, or speed
      (rad/s) if this is more;
    - ``angle``: largest deviation (rad) of a steering joint that does not turn towards its target.
    """

    time: float = 0.5
    speed_time: float = 1.0
    excess: float = 0.3
    share: float = 0.5
    speed: float = 0.3
    angle: float = 0.2

    def stricter(self, other: FollowLimits) -> FollowLimits:
        """Returns the smaller one of each two limits."""
        return FollowLimits(*map(min, self, other))


class Axis:
    """Measured position and velocity and the target of one motor of the base.

    - ``wheel``: index of the wheel in ``Robot.wheels``;
    - ``channel``: name of the motor controller's channel;
    - ``steering``: ``True`` for a steering motor, ``False`` for a propulsion motor;
    - ``time``: time (s) of the newest measurement;
    - ``position``: joint position in rad, NaN before the first measurement;
    - ``velocity``: joint velocity in rad/s, NaN before the first measurement;
    - ``target``: commanded wheel speed (rad/s) or steering angle (rad);
    - ``homed``: ``True`` if the zero position of the joint is known;
    - ``jump``: angle (rad) by which the position of a homed steering joint has jumped, faster than
      the motor can turn; 0 if the position has not jumped;
    - ``leaps``: number of the latest reported wheel speeds that no motion explains, see ``LEAPS``;
    - ``powered``: ``False`` if the motor gets no torque, whatever the base does; see
      ``CanBase.power_only``;
    - ``follows``: ``True`` while the motor has torque and is commanded to follow its target: the
      driver then compares its motion with the target;
    - ``limits``: largest deviations from the target.
    """

    def __init__(self, actuator: Actuator, wheel: int, channel: str) -> None:
        self.actuator = actuator
        self.joint = actuator.joint
        self.wheel = wheel
        self.channel = channel
        self.steering = actuator.role == "steering"
        self.time = -math.inf
        self.position = math.nan
        self.velocity = math.nan
        self.target = 0.0
        self.homed = not self.steering
        self.jump = 0.0
        self.leaps = 0.0
        self.powered = True
        self.follows = False
        self.limits = FollowLimits()

    def update(self, time: float, position: float, velocity: float | None = None) -> None:
        """Stores a measured joint position (rad) and joint velocity (rad/s).

        If ``velocity`` is ``None``, the joint velocity is computed from the last two joint
        positions.
        """
        if self.steering and self.homed and not self.jump:
            change = abs(position - self.position)
            motion = JUMP_SPEED * self.actuator.max_velocity * max(time - self.time, JUMP_TIME)
            if change > motion + JUMP:
                self.jump = change
        if velocity is None:
            dt = time - self.time
            velocity = (position - self.position) / dt if 0.0 < dt < 1.0 else 0.0
        elif not self.steering:
            elapsed = time - self.time
            largest = LEAP * self.actuator.max_acceleration * max(elapsed, JUMP_TIME)
            largest += self.limits.speed
            leaps = self.leaps + 1.0 if abs(velocity - self.velocity) > largest else self.leaps
            if leaps:
                self.leaps = min(max(leaps - LEAP_DECAY * elapsed, 0.0), 2.0 * LEAPS)
        self.time, self.position, self.velocity = time, position, velocity

    def hold(self) -> None:
        """Sets the target angle of a steering motor to the measured angle, and a target speed to 0.

        Before the first report of its position the target angle is 0, and no motor follows it.
        """
        known = self.steering and math.isfinite(self.position)
        self.target = self.position if known else 0.0

    def lose_reference(self) -> None:
        """Marks a steering motor as not homed after a restart of the motor controller."""
        self.homed = not self.steering
        self.target = 0.0


class Deviation(NamedTuple):
    """A motor that does not do what it is commanded to, with a text for the operator."""

    axis: Axis
    text: str


# -- while a motor follows its target --------------------------------------------------------------


class Follower:
    """Judges whether one motor follows its target.

    - ``deviating_since``: start time (s) of the present deviation, or infinite.
    """

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.deviating_since = math.inf
        self._follows = False
        self._target = 0.0
        self._commanded_at = 0.0
        self._earlier: deque[tuple[float, float]] = deque()
        """Each earlier target of the last ``limits.time`` seconds, with the time (s) at which it
        was commanded last."""
        self._rolling = 0.0
        self._excess = 0.0
        self._travel = 0.0
        self._steady = self._away = 0.0
        self._frozen_since = math.inf
        self._position = self._velocity = math.nan
        self._target_then = 0.0

    def _begin(self, now: float) -> None:
        """Forgets all earlier targets and deviations."""
        axis = self.axis
        self._follows = True
        self.deviating_since = self._frozen_since = math.inf
        self._target, self._commanded_at = axis.target, now
        self._earlier.clear()
        # A wheel that rolled when its motor got torque brakes first.
        self._rolling = axis.velocity if not (axis.steering or axis.target) else 0.0
        self._steady, self._away = axis.target, 0.0  # travel (rad) away from a steady target
        self._excess = 0.0  # travel (rad) of the present deviation beyond all recent targets
        self._travel = 0.0  # travel (rad) since the wheel is commanded to stand
        self._position = self._velocity = math.nan

    def problem(self, now: float) -> str:
        """Returns what is wrong with the motion of the motor, or an empty text.

        Called once in each control cycle.
        """
        axis = self.axis
        limits = axis.limits
        if not axis.follows:
            self._follows, self.deviating_since = False, math.inf
            return ""
        if not self._follows:
            self._begin(now)
        target, time, position, velocity = axis.target, axis.time, axis.position, axis.velocity
        if axis.steering:
            measured, longest, tolerance = position, limits.time, limits.angle
            error = target - position
            approaches = velocity * error > 0.0 and abs(velocity) >= STANDING
            deviates = abs(error) > tolerance and not approaches
            self._note_swing(now, target, error)
        else:
            measured, longest, tolerance = velocity, limits.speed_time, limits.speed
            deviates = self._wheel_deviates(now, target, velocity)
        if position != self._position or velocity != self._velocity:
            self._position, self._velocity, self._target_then = position, velocity, target
            self._frozen_since = math.inf
        elif abs(target - self._target_then) <= tolerance or abs(target - measured) <= tolerance:
            self._frozen_since = math.inf
        elif time < self._frozen_since:
            self._frozen_since = time
        if not deviates:
            self.deviating_since = math.inf
        elif time < self.deviating_since:
            self.deviating_since = time
        if axis.leaps > LEAPS:
            return f"the reported speed of the {axis.channel} jumps, as no wheel can"
        lasts = time - self.deviating_since
        if (
            lasts > longest
            or (lasts > SHORTEST and self._excess > limits.excess)
            or abs(self._travel) > REST_TRAVEL
        ):
            if not (axis.steering or target or self._earlier):
                return f"the {axis.channel} turns, although it is commanded to stand"
            return f"the {axis.channel} does not follow its target"
        if self._away > SWING:
            return f"the {axis.channel} swings about another angle than its target"
        if time - self._frozen_since > limits.time:
            return f"the {axis.channel} does not follow its target, and its reports do not change"
        return ""

    def _note_swing(self, now: float, target: float, error: float) -> None:
        """Sums up the travel of a steering joint away from a target that does not change."""
        limit = 0.5 * self.axis.limits.angle
        if abs(target - self._steady) > limit:
            self._steady, self._away = target, 0.0
        travel = self.axis.position - self._position
        if travel * error < 0.0 and abs(error) > limit:
            self._away += abs(travel)
        self._away = max(self._away - SWING_DECAY * (now - self._commanded_at), 0.0)
        self._commanded_at = now

    def _wheel_deviates(self, now: float, target: float, speed: float) -> bool:
        """Checks whether the speed of a wheel (rad/s) is beyond its targets of the last half second
        and a tolerance, and sums up its travel."""
        earlier, limits = self._earlier, self.axis.limits
        elapsed = now - self._commanded_at
        dt = LONGEST_STEP if elapsed > LONGEST_STEP else elapsed
        if target != self._target:
            earlier.append((self._commanded_at, self._target))
            self._target = target
        self._commanded_at = now
        if self._rolling:
            braked = STOP_SHARE * self.axis.actuator.max_acceleration * dt
            self._rolling = math.copysign(max(abs(self._rolling) - braked, 0.0), self._rolling)
            earlier.append((now, self._rolling))
        while earlier and earlier[0][0] < now - limits.time:
            earlier.popleft()
        if target or earlier or abs(speed) <= STANDING:
            self._travel = 0.0
        else:
            self._travel += speed * dt
        if abs(speed - target) <= limits.speed:
            self._excess = 0.0
            return False
        lowest = highest = target
        for _, value in earlier:
            lowest, highest = min(lowest, value), max(highest, value)
        lowest -= max(limits.share * abs(lowest), limits.speed)
        highest += max(limits.share * abs(highest), limits.speed)
        excess = max(speed - highest, lowest - speed)
        self._excess = self._excess + excess * dt if excess > 0.0 else 0.0
        return excess > 0.0


# -- after the command to stop ---------------------------------------------------------------------


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


class Stopper:
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
        if allowed < STOPPED:
            # The motor should stand by now.
            self._travel = self._travel + speed * dt if speed > STANDING else 0.0
        too_fast = speed > max(allowed, STOPPED) and now > self._falls_at
        self._too_fast_since = min(self._too_fast_since, axis.time) if too_fast else math.inf


def obedience(stoppers: Sequence[Stopper], now: float) -> Obedience:
    """Judges the stop of some motors; called once in each control cycle after ``begin``."""
    for stopper in stoppers:
        stopper.update(now)
    if any(now - stopper.axis.time > REPORT_AGE for stopper in stoppers):
        return Obedience.UNKNOWN
    if any(stopper.disobeys for stopper in stoppers):
        return Obedience.DISOBEYS
    stands = all(stopper.stands(now) for stopper in stoppers)
    return Obedience.STANDS if stands else Obedience.SLOWS
