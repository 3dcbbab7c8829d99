"""Limits the wheel speeds to the speed and acceleration limits of the drive motors.

All wheel speeds are scaled by the same factor, so that the direction of the twist and the centre of
rotation do not change.  A wheel with a lateral offset also rolls while its steering joint turns,
although the robot stands.  This part of a wheel speed is not scaled, because a drive that lags
behind its steering joint would move the robot.
"""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.model.float_sum import float_sum
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


class DriveMotors:
    """Limits the wheel speeds of the drive motors and stores the last command.

    The stored command consists of the speed of each wheel (rad/s) and of the resulting twist.

    - ``rolling_speeds``: last commanded speeds (rad/s) without the speeds that turning steering
      joints add.
    """

    def __init__(self, geometry: BaseGeometry) -> None:
        self._limits = tuple(
            (i, w.max_speed, w.max_acceleration)
            for i, w in enumerate(geometry.wheels)
            if w.driven and not w.swivel
        )
        self._shared = geometry.spin_groups
        self._zeros = (0.0,) * len(geometry.wheels)
        self.reset()

    def reset(self, states: JointStates | None = None, twist: Twist = ZERO_TWIST) -> None:
        """Sets the last commanded speeds to the measured speeds in ``states``.

        ``twist`` is the twist that the measured wheel speeds produce.  Without ``states``, all
        drive motors start from rest.
        """
        self._speeds: tuple[float, ...] = self._zeros if states is None else (*states.speeds,)
        self.rolling_speeds: Sequence[float] = self._speeds
        self._pushes: Sequence[float] = self._zeros
        self.twist = twist

    def resume(self, previous: DriveMotors) -> None:
        """Copies the last commanded wheel speeds and twist from ``previous``."""
        self._speeds, self._pushes = previous._speeds, previous._pushes
        self.rolling_speeds, self.twist = previous.rolling_speeds, previous.twist

    @property
    def commanded_speeds(self) -> Sequence[float]:
        """Last commanded wheel speeds, rad/s."""
        return self._speeds

    def average_shared(self, speeds: list[float]) -> list[float]:
        """Sets the speeds of wheels that share a drive motor to their mean speed, in place."""
        for group in self._shared:
            mean = float_sum(speeds[i] for i in group) / len(group)
            for i in group:
                speeds[i] = mean
        return speeds

    def limit_speeds(
        self, twist: Twist, speeds: list[float], pushes: Sequence[float] | None = None
    ) -> tuple[Twist, list[float]]:
        """Scales all wheel speeds and the twist so that no wheel exceeds its speed limit.

        ``pushes``: speeds (rad/s) that ``limit_accelerations`` adds later, because steering joints
        turn.
        """
        scale = 1.0
        for i, limit, _ in self._limits:
            v = speeds[i]
            if pushes and pushes[i]:
                limit -= pushes[i] if v > 0.0 else -pushes[i]
            if v * scale > limit or v * scale < -limit:
                scale = max(limit, 0.0) / abs(v)
        if scale < 1.0:
            return twist.scaled(scale), [v * scale for v in speeds]
        return twist, speeds

    def limit_accelerations(
        self,
        twist: Twist,
        speeds: Sequence[float],
        dt: float | None,
        pushes: Sequence[float] | None = None,
    ) -> tuple[Twist, tuple[float, ...]]:
        """Limits the change of the wheel speeds and the twist during the next ``dt`` s.

        The limited wheel speeds are v0 + k (v - v0), where v0 are the last commanded speeds and v
        are the requested speeds.  The share k <= 1 of the change is as large as the acceleration
        limits of all wheels allow.  The twist changes by the same share k as the wheel speeds.  If
        ``dt`` is ``None``, the change of the wheel speeds is not limited.  ``pushes`` are speeds
        (rad/s) of wheels with a lateral offset while their steering joints turn.  They are added to
        the limited wheel speeds.  The limited twist and wheel speeds are returned and stored as the
        last command.
        """
        pushes = pushes or self._zeros
        if dt is not None:
            last_speeds, last_pushes = self.rolling_speeds, self._pushes
            pushed = pushes is not last_pushes
            share = 1.0
            for i, _, acceleration in self._limits:
                change = speeds[i] - last_speeds[i]
                max_change = acceleration * dt
                if pushed:
                    push = pushes[i] - last_pushes[i]
                    max_change = max(max_change - (push if change > 0.0 else -push), 0.0)
                if change * share > max_change or change * share < -max_change:
                    share = max_change / abs(change)
            if share < 1.0:
                speeds = [u + share * (v - u) for v, u in zip(speeds, last_speeds, strict=True)]
                twist = self.twist.towards(twist, share)
        self.twist, self.rolling_speeds, self._pushes = twist, speeds, pushes
        if pushes is not self._zeros:
            speeds = [v + p for v, p in zip(speeds, pushes, strict=True)]
        self._speeds = (*speeds,)
        return twist, self._speeds
