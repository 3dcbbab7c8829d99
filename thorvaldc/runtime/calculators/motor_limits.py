"""The drive motors together: one factor for all keeps each within its limits."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


class Motors:
    """Remembers the speeds (rad/s, per wheel) last commanded and the twist that they make."""

    def __init__(self, geometry: BaseGeometry) -> None:
        self._limits = tuple(
            (i, w.max_speed, w.max_acceleration)
            for i, w in enumerate(geometry.wheels)
            if w.driven and not w.swivel
        )
        self._shared = geometry.spin_groups
        self._standing = (0.0,) * len(geometry.wheels)
        self.reset()

    def reset(self, states: JointStates | None = None, twist: Twist = ZERO_TWIST) -> None:
        """Start from the speeds of ``states``, which are those of ``twist``; from rest without."""
        self._speeds: tuple[float, ...] = self._standing if states is None else (*states.speeds,)
        self.twist = twist

    def resume(self, before: Motors) -> None:
        """Go on from what those of ``before`` were commanded."""
        self._speeds, self.twist = before._speeds, before.twist

    def sharing(self, speeds: list[float]) -> list[float]:
        """Wheels on one motor have one speed, the mean of theirs (in place)."""
        for group in self._shared:
            mean = sum(speeds[i] for i in group) / len(group)
            for i in group:
                speeds[i] = mean
        return speeds

    def slowed(self, twist: Twist, speeds: list[float]) -> tuple[Twist, list[float]]:
        """All slowed by what brings the fastest to its limit."""
        slow = 1.0
        for i, top, _ in self._limits:
            v = speeds[i]
            if v * slow > top or v * slow < -top:
                slow = top / abs(v)
        if slow < 1.0:
            return twist.scaled(slow), [v * slow for v in speeds]
        return twist, speeds

    def reached(
        self, twist: Twist, speeds: Sequence[float], dt: float | None
    ) -> tuple[Twist, tuple[float, ...]]:
        """What can be commanded for the next ``dt`` s (``None``: at once), and remembered.

        All go the same part of the way from what was commanded before, as
        much as the motor with the longest way can.
        """
        if dt is not None:
            before = self._speeds
            share = 1.0
            for i, _, acceleration in self._limits:
                change = speeds[i] - before[i]
                most = acceleration * dt
                if change * share > most or change * share < -most:
                    share = most / abs(change)
            if share < 1.0:
                speeds = [b + share * (v - b) for v, b in zip(speeds, before, strict=True)]
                (vx, vy, wz), (bx, by, bw) = twist, self.twist
                twist = Twist(
                    bx + share * (vx - bx), by + share * (vy - by), bw + share * (wz - bw)
                )
        self.twist, self._speeds = twist, (*speeds,)
        return twist, self._speeds
