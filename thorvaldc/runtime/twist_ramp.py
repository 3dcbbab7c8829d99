"""The ramp from the present twist to the commanded twist, and the notice that it is not reached."""

from __future__ import annotations

import math
from typing import Final

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator, BaseCommand, BaseGeometry, WheelGeometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist, twist_text

LEAD: Final = 0.1
"""Largest difference (m/s) by which the ramp may lead the twist of the wheels."""
LONGEST_SMOOTHING: Final = 0.5
"""Longest time (s) over which the twist ramp is smoothed."""


class Ramp:
    """Ramps a twist towards a commanded twist along a straight line, with smoothed corners.

    In each tick of ``dt`` s, the twist r moves towards the commanded twist g by the largest share k
    that the acceleration limits allow:

        r <- r + k (g - r),   k = min(1, a_max dt / |dv|, alpha_max dt / |dw|)

    The direction of the straight ramp is constant.  On a ramp from rest or to rest, the centre of
    rotation therefore does not move.  At a corner of the straight ramp, however, steering joints
    would have to reach their full steering rate in zero time.  The attribute ``twist`` is therefore
    the mean of the straight ramp over the last ``smoothing`` s, the time that steering joints need
    to reach their full rate.  A stop is no ramp of a twist: the calculator takes the last commands
    of the wheels to rest, and the ramp restarts from their twist.

    While a step makes the twist smaller, the decelerations of the robot file take the place of
    a_max and alpha_max; no program can change them at run time.  The yaw rate is multiplied by
    ``length`` (m) to convert the yaw rate to a linear speed.
    """

    def __init__(self, settings: DriverSettings, length: float, smoothing: float) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self._length = length
        count = 1 + round(min(smoothing, LONGEST_SMOOTHING) * settings.rate)
        self._history = [ZERO_TWIST] * count

    def follow(self, goal: Twist, dt: float, last: BaseCommand | None) -> Twist:
        """Moves the twist ramp one step of ``dt`` s towards the twist ``goal``.

        ``last``: previous command that the wheels follow, or ``None`` before the first one.
        """
        if last is not None:
            self.limit_lead(last.target, last.twist, last.aligned, last.infeasible)
        return self.step(goal, dt, last is None or last.scale == 1.0)

    def step(self, goal: Twist, dt: float, grows: bool = True) -> Twist:
        """Moves the twist ramp towards ``goal`` for ``dt`` s and returns the new twist.

        ``grows`` is ``False`` while wheels are at their speed limits.  The twist then takes the
        direction of ``goal``, but does not grow.  A larger twist would only delay the next stop.
        """
        history = self._history
        if not grows:
            size, limit = self._product(goal, goal), self._product(self.twist, self.twist)
            if size > limit:
                goal = goal.scaled(math.sqrt(limit / size))
        last = history[-1]
        if goal == last:
            if history[0] == last and history.count(last) == len(history):
                self.twist = last  # exact, because the mean would have a rounding error
                return last
            new = last
        else:
            new = self._straight(last, goal, dt)
        del history[0]
        history.append(new)
        n = len(history)
        vx, vy, wz = map(float_sum, zip(*history, strict=True))
        self.twist = Twist(vx / n, vy / n, wz / n)
        return self.twist

    def _straight(self, start: Twist, goal: Twist, dt: float) -> Twist:
        """Returns the twist ``dt`` s after ``start`` on the straight line to ``goal``."""
        settings, share = self.settings, 1.0
        linear, angular = settings.max_linear_acceleration, settings.max_angular_acceleration
        if self._product(start, goal) < self._product(start, start):
            linear, angular = settings.max_linear_deceleration, settings.max_angular_deceleration
        dv = math.hypot(goal.vx - start.vx, goal.vy - start.vy)
        dw = abs(goal.wz - start.wz)
        if dv > linear * dt:
            share = linear * dt / dv
        if dw * share > angular * dt:
            share = angular * dt / dw
        return goal if share >= 1.0 else start.towards(goal, share)

    def limit_lead(
        self,
        target: Twist,
        actual: Twist,
        aligned: bool = True,
        unreachable: Twist = ZERO_TWIST,
    ) -> None:
        """Limits the lead of the twist ramp over the motion of the wheels to ``LEAD``.

        While wheels steer or are at their limits, the robot is slower than the ramp.  Without a
        limit of the lead, the robot would accelerate abruptly when the wheels are ready.

        - ``target``: twist that the wheels point along, or turn to.
        - ``actual``: twist of the wheels.
        - ``aligned``: ``False`` if steered wheels have to turn far.
        - ``unreachable``: part of the ramp's twist that the wheels cannot make.  The ramp does not
          wait for this part, because it may pass through unreachable twists to reachable ones.

        Only the size of ``actual`` along ``target`` counts.  While wheels turn, ``actual`` also has
        other components, for example because contact points with trail move.  If the ramp
        followed them, the steering angles would follow their own motion, and wheels could turn to
        and fro forever.  While wheels have to turn far, the ramp slows down but keeps the
        direction of its twist.
        """
        if not aligned:
            self._scale(self._lead_share(self.twist, actual))
            return
        share = self._share_made(target, actual)
        reference = Twist(
            share * target.vx + unreachable.vx,
            share * target.vy + unreachable.vy,
            share * target.wz + unreachable.wz,
        )
        dx, dy = self.twist.vx - reference.vx, self.twist.vy - reference.vy
        dw = self._length * (self.twist.wz - reference.wz)
        ahead = dx * dx + dy * dy + dw * dw
        if ahead <= LEAD * LEAD:
            return
        share = LEAD / math.sqrt(ahead)
        self.twist = reference.towards(self.twist, share)
        self._history = [reference.towards(twist, share) for twist in self._history]

    def _product(self, a: Twist, b: Twist) -> float:
        return a.vx * b.vx + a.vy * b.vy + self._length * self._length * a.wz * b.wz

    def _share_made(self, target: Twist, actual: Twist) -> float:
        """Returns the share of ``target`` that the wheels make, negative for the reverse motion."""
        square = self._product(target, target)
        if target == actual or square == 0.0:
            return 1.0
        return self._product(target, actual) / square

    def _lead_share(self, twist: Twist, actual: Twist) -> float:
        """Returns the factor, at most 1, by which ``twist`` leads ``actual`` by ``LEAD``."""
        size = math.sqrt(self._product(twist, twist))
        if size <= LEAD:
            return 1.0
        return (max(self._product(twist, actual) / size, 0.0) + LEAD) / size

    def _scale(self, share: float) -> None:
        if share < 1.0:
            self.twist = self.twist.scaled(share)
            self._history = [twist.scaled(share) for twist in self._history]

    def restart(self, twist: Twist) -> None:
        """Sets the twist ramp to ``twist``, as if the twist had been constant before."""
        self.twist = twist
        self._history = [twist] * len(self._history)


# -- a robot that does not follow its commanded twist for longer than any change takes ----------
#
# While a robot accelerates and its wheels turn, it drives at another twist than the commanded one.
# This difference ends after some seconds.  A difference that lasts has a cause: the steering limits
# of wheels, fixed wheels, a speed limit, a steering joint that does not move, or a mistake in the
# base calculator.  ``LastingDifference`` looks at the difference only, so that it notices every
# cause.  A difference lasts from the time on that the change to the commanded twist takes at most:
#
#     T = 2 max((|v| + |v'|) / a, (|w| + |w'|) / alpha) + 2 t + MARGIN
#
# with the commanded twist (v, w), the twist (v', w') of the joint commands when the command
# changed, the lower one of acceleration and deceleration of the robot file (a, alpha), and the time
# t in which the slowest steering joint turns through its range.  The factors 2 are for a robot that
# has to stop, turn its wheels and start again on the way; ``bench.following`` and
# ``bench.crossing`` count reports of twists that the robot makes after all.

MARGIN: Final = 2.0
"""Time (s) beyond the slowest change of the twist before a difference lasts."""
NEGLIGIBLE: Final = 0.01
"""Difference (m/s) of two twists that counts as none."""
_NEGLIGIBLE_SHARE: Final = 0.02
"""Difference of two twists that counts as none, as a share of the commanded twist."""
_SAME_COMMAND: Final = 0.2
"""A command that changes by at most this share of the difference is still the same command."""
_FULL_SPEED: Final = 0.98
"""Share of its speed limit from which on a drive motor is named as the cause."""
_MISPLACED: Final = math.radians(3.0)
"""Steering error (rad) of a joint that stands still, from which on it is named as the cause."""


class LastingDifference:
    """Measures for how long a robot has not followed its commanded twist.

    Commands of a joystick or of a controller tremble.  The time therefore starts again only with a
    command that differs from the first one by more than ``_SAME_COMMAND`` of the difference.
    """

    def __init__(self, geometry: BaseGeometry) -> None:
        self._length = geometry.length
        self._steering_time = max(
            (_travel_time(w) for w in geometry.wheels if w.steered), default=0.0
        )
        self._commanded: Twist | None = None
        self._since = self._until = 0.0

    def update(
        self, now: float, commanded: Twist, actual: Twist, settings: DriverSettings
    ) -> float:
        """Returns for how many seconds the difference has lasted, or 0 if it may end by itself.

        - ``commanded``: twist that the robot has to reach.
        - ``actual``: twist of the joint commands.
        """
        difference = self._distance(commanded, actual)
        if difference <= NEGLIGIBLE or (
            difference <= _NEGLIGIBLE_SHARE * self._distance(commanded, ZERO_TWIST)
        ):
            self._commanded = None
            return 0.0
        first = self._commanded
        if first is None or self._distance(commanded, first) > _SAME_COMMAND * difference:
            self._commanded, self._since = commanded, now
            linear = min(settings.max_linear_acceleration, settings.max_linear_deceleration)
            angular = min(settings.max_angular_acceleration, settings.max_angular_deceleration)
            ramp = max(
                (commanded.speed + actual.speed) / linear,
                (abs(commanded.wz) + abs(actual.wz)) / angular,
            )
            self._until = now + 2.0 * (ramp + self._steering_time) + MARGIN
        return now - self._since if now >= self._until else 0.0

    def reset(self) -> None:
        """Forgets the difference, for example while the robot accepts no motion."""
        self._commanded = None

    def _distance(self, a: Twist, b: Twist) -> float:
        return math.hypot(a.vx - b.vx, a.vy - b.vy, self._length * (a.wz - b.wz))


def _travel_time(wheel: WheelGeometry) -> float:
    """Returns the time (s) in which a steering joint turns through its range, at most one turn."""
    travel = math.tau
    if wheel.lower is not None and wheel.upper is not None:
        travel = min(travel, wheel.upper - wheel.lower)
    cruise = travel / wheel.max_rate if 0.0 < wheel.max_rate < math.inf else 0.0
    start = wheel.max_rate / wheel.max_rate_change if wheel.max_rate_change > 0.0 else 0.0
    return cruise + (start if math.isfinite(start) else 0.0)


def is_axle_swing(commanded: Twist, infeasible: Twist) -> bool:
    """Returns whether only the sideways motion of ``base_link`` in a turn is infeasible.

    If a fixed axle is not under ``base_link``, a turn (vx, 0, wz) also moves ``base_link``
    sideways.  The commanded twist with vy = 0 is then infeasible, but the user made no mistake.
    In this case the infeasible part of the twist is perpendicular to the commanded velocity, and
    the yaw rate of the infeasible part is zero.
    """
    dot = commanded.vx * infeasible.vx + commanded.vy * infeasible.vy
    return abs(dot) < 1e-6 and abs(infeasible.wz) < 1e-6


def forbidding_part(robot: Robot) -> str:
    """Returns the part that forbids a twist which all steering joints can reach, and its verb."""
    fixed = any(w.steering_joint is None and w.swivel_joint is None for w in robot.wheels)
    return "fixed wheels do" if fixed else "base calculator does"


def difference_text(
    robot: Robot,
    calculator: BaseCalculator,
    commanded: Twist,
    infeasible: Twist,
    limit: str,
    command: BaseCommand,
    joints: JointStates,
) -> str:
    """Returns the twist that a robot drives instead of the commanded one, and the causes.

    - ``infeasible``: part of the commanded twist that the wheels do not allow.
    - ``limit``: speed limit that scales the commanded twist, or an empty text.
    """
    causes = []
    if not is_axle_swing(commanded, infeasible):
        wheels = ", ".join(robot.wheels[i].name for i in calculator.limiting_wheels(commanded))
        causes.append(
            f"{wheels} cannot steer to it"
            if wheels
            else f"its {forbidding_part(robot)} not allow it"
        )
    if limit:
        causes.append(f"limited by {limit}")
    fast = ", ".join(
        wheel.name
        for wheel, speed in zip(calculator.geometry.wheels, command.joints.speeds, strict=True)
        if wheel.driven and abs(speed) > _FULL_SPEED * wheel.max_speed
    )
    if fast:
        causes.append(f"the motor of {fast} is at its speed limit")
    stuck = ", ".join(
        wheel.name
        for wheel, angle, target in zip(
            robot.wheels, joints.angles, command.joints.angles, strict=True
        )
        if wheel.steered and abs(angle - target) > _MISPLACED
    )
    if stuck:
        causes.append(f"{stuck} did not reach the commanded steering angle")
    drives = f"drives {twist_text(command.twist)} instead of {twist_text(commanded)}"
    return f"{drives}: {'; '.join(causes) or 'cause unknown'}"
