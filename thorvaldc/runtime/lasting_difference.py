"""Notices that a robot does not follow its commanded twist for longer than any change takes.

While a robot accelerates and its wheels turn, it drives at another twist than the commanded one.
This difference ends after some seconds.  A difference that lasts has a cause: the steering limits
of wheels, fixed wheels, a speed limit, a steering joint that does not move, or a mistake in the
base calculator.  ``LastingDifference`` looks at the difference only, so that it notices every
cause.  A difference lasts from the time on that the change to the commanded twist takes at most:

    T = 2 max((|v| + |v'|) / a, (|w| + |w'|) / alpha) + 2 t + MARGIN

with the commanded twist (v, w), the twist (v', w') of the joint commands when the command changed,
the lower one of acceleration and deceleration of the robot file (a, alpha), and the time t in which
the slowest steering joint turns through its range.  The factors 2 are for a robot that has to
stop, turn its wheels and start again on the way; ``bench.following`` and ``bench.crossing`` count
reports of twists that the robot makes after all.
"""

from __future__ import annotations

import math

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import (
    BaseCalculator,
    BaseCommand,
    BaseGeometry,
    WheelGeometry,
)
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist, twist_text

MARGIN = 2.0
"""Time (s) beyond the slowest change of the twist before a difference lasts."""
NEGLIGIBLE = 0.01
"""Difference (m/s) of two twists that counts as none."""
_NEGLIGIBLE_SHARE = 0.02
"""Difference of two twists that counts as none, as a share of the commanded twist."""
_SAME_COMMAND = 0.2
"""A command that changes by at most this share of the difference is still the same command."""
_FULL_SPEED = 0.98
"""Share of its speed limit from which on a drive motor is named as the cause."""
_MISPLACED = math.radians(3.0)
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
        reason = f"{wheels} cannot steer to it" if wheels else "its fixed wheels do not allow it"
        causes.append(reason)
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
