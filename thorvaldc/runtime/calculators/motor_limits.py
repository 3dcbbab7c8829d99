"""Speed and acceleration limits of the drive motors, applied to all wheels together.

One common factor for all wheels keeps the direction of the twist, and so the centre of rotation.
"""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


class DriveMotors:
    """The drive motors with the last commanded speeds (rad/s, per wheel) and their ``twist``."""

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
        """Starts from the speeds of ``states``, which belong to ``twist``; by default from rest."""
        self._speeds: tuple[float, ...] = self._zeros if states is None else (*states.speeds,)
        self.twist = twist

    def resume(self, previous: DriveMotors) -> None:
        """Takes over the last command of ``previous``."""
        self._speeds, self.twist = previous._speeds, previous.twist

    def average_shared(self, speeds: list[float]) -> list[float]:
        """Sets the speeds of wheels on one motor to their mean, in place."""
        for group in self._shared:
            mean = sum(speeds[i] for i in group) / len(group)
            for i in group:
                speeds[i] = mean
        return speeds

    def limit_speeds(self, twist: Twist, speeds: list[float]) -> tuple[Twist, list[float]]:
        """Scales all speeds and the twist so that no wheel exceeds its speed limit."""
        scale = 1.0
        for i, limit, _ in self._limits:
            v = speeds[i]
            if v * scale > limit or v * scale < -limit:
                scale = limit / abs(v)
        if scale < 1.0:
            return twist.scaled(scale), [v * scale for v in speeds]
        return twist, speeds

    def limit_accelerations(
        self, twist: Twist, speeds: Sequence[float], dt: float | None
    ) -> tuple[Twist, tuple[float, ...]]:
        """Returns the command for the next ``dt`` s and stores it (``None``: no limit).

        With the last command v0 and the largest share k <= 1 such that no wheel exceeds its
        acceleration, all speeds become v0 + k (v - v0), and so does the twist.
        """
        if dt is not None:
            last_speeds = self._speeds
            share = 1.0
            for i, _, acceleration in self._limits:
                change = speeds[i] - last_speeds[i]
                max_change = acceleration * dt
                if change * share > max_change or change * share < -max_change:
                    share = max_change / abs(change)
            if share < 1.0:
                speeds = [u + share * (v - u) for v, u in zip(speeds, last_speeds, strict=True)]
                (vx, vy, wz), (ux, uy, uw) = twist, self.twist
                twist = Twist(
                    ux + share * (vx - ux), uy + share * (vy - uy), uw + share * (wz - uw)
                )
        self.twist, self._speeds = twist, (*speeds,)
        return twist, self._speeds
