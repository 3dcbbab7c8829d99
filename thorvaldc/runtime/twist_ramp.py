"""The ramp from the present to the commanded twist, within the acceleration limits."""

from __future__ import annotations

import math

from thorvaldc.model import DriverSettings
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

LEAD = 0.1
"""Largest difference (m/s, of wheel speeds) between the ramp and the twist of the wheels."""
LONGEST_SMOOTHING = 0.5
"""Longest time (s) over which the ramp is smoothed."""


class Ramp:
    """A straight line in the space of twists, smoothed at its corners.

    In each tick the straight ramp moves from r to the goal g by the largest allowed share k:

        r <- r + k (g - r),   k = min(1, a_max dt / |dv|, alpha_max dt / |dw|)

    Its direction is constant, so from rest and to rest the centre of rotation stays.  At its
    corners, though, steering joints would have to reach their rate in zero time.  ``twist`` is
    therefore the mean of r over the last ``smoothing`` s, the time in which steering joints
    reach their rate.  A ramp to zero is not smoothed: the wheels keep their directions, and a
    stop begins in the same tick.  ``length`` (m): lever that converts angular to linear speed.
    """

    def __init__(self, settings: DriverSettings, length: float, smoothing: float) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self._length = length
        count = 1 + round(min(smoothing, LONGEST_SMOOTHING) * settings.rate)
        self._history = [ZERO_TWIST] * count

    def step(self, goal: Twist, dt: float) -> Twist:
        """Moves ``dt`` s towards ``goal`` and returns the new twist."""
        history = self._history
        if goal == ZERO_TWIST:
            if self.twist != ZERO_TWIST:
                self.restart(self._straight(self.twist, goal, dt))
            return self.twist
        last = history[-1]
        if goal == last:
            if history[0] == last and history.count(last) == len(history):
                self.twist = last  # exactly; the mean would have a rounding error
                return last
            new = last
        else:
            new = self._straight(last, goal, dt)
        del history[0]
        history.append(new)
        n = len(history)
        vx, vy, wz = map(sum, zip(*history, strict=True))
        self.twist = Twist(vx / n, vy / n, wz / n)
        return self.twist

    def _straight(self, start: Twist, goal: Twist, dt: float) -> Twist:
        """Returns the twist ``dt`` s after ``start`` on the straight line to ``goal``."""
        settings, share = self.settings, 1.0
        dv = math.hypot(goal.vx - start.vx, goal.vy - start.vy)
        dw = abs(goal.wz - start.wz)
        if dv > settings.max_linear_acceleration * dt:
            share = settings.max_linear_acceleration * dt / dv
        if dw * share > settings.max_angular_acceleration * dt:
            share = settings.max_angular_acceleration * dt / dw
        return goal if share >= 1.0 else _interpolate(start, goal, share)

    def limit_lead(self, actual: Twist, aligned: bool = True) -> None:
        """Moves the ramp back to at most ``LEAD`` ahead of ``actual``, the twist of the wheels.

        Steering wheels and wheels at their limits make the robot slower than the ramp.  Without
        this limit the robot would jump as soon as they are ready.  If wheels have far to
        turn (not ``aligned``), the ramp only slows down and keeps its direction.  A change
        towards the actual direction would call back wheels that turn the long way round because
        of a steering limit, and they would never arrive.
        """
        vx, vy, wz = self.twist
        if not aligned:
            self._slow_down(actual)
            return
        dx, dy, dw = vx - actual.vx, vy - actual.vy, self._length * (wz - actual.wz)
        ahead = dx * dx + dy * dy + dw * dw
        if ahead <= LEAD * LEAD:
            return
        share = LEAD / math.sqrt(ahead)
        self.twist = _interpolate(actual, self.twist, share)
        self._history = [_interpolate(actual, twist, share) for twist in self._history]

    def _slow_down(self, actual: Twist) -> None:
        """Scales the ramp so that it leads ``actual``, projected on its direction, by ``LEAD``."""
        vx, vy, wz = self.twist
        lever = self._length * self._length
        size = math.sqrt(vx * vx + vy * vy + lever * wz * wz)
        if size <= LEAD:
            return
        along = (vx * actual.vx + vy * actual.vy + lever * wz * actual.wz) / size
        share = (max(along, 0.0) + LEAD) / size
        if share < 1.0:
            self.twist = self.twist.scaled(share)
            self._history = [twist.scaled(share) for twist in self._history]

    def restart(self, twist: Twist) -> None:
        """Sets the ramp to ``twist``, as if it had been constant."""
        self.twist = twist
        self._history = [twist] * len(self._history)


def _interpolate(a: Twist, b: Twist, share: float) -> Twist:
    return Twist(
        a.vx + share * (b.vx - a.vx), a.vy + share * (b.vy - a.vy), a.wz + share * (b.wz - a.wz)
    )
