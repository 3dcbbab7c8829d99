"""The ramp from the present twist to the commanded twist, within the acceleration limits."""

from __future__ import annotations

import math

from thorvaldc.model import DriverSettings
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

LEAD = 0.1
"""Largest difference (m/s) between the ramp and the twist of the wheels, as a wheel speed."""
LONGEST_SMOOTHING = 0.5
"""Longest time (s) over which the ramp is smoothed."""


class Ramp:
    """A ramp along a straight line in the space of twists, with smoothed corners.

    In each tick, the straight ramp moves from the twist r to the goal g by the largest allowed
    share k:

        r <- r + k (g - r),   k = min(1, a_max dt / |dv|, alpha_max dt / |dw|)

    The direction of the straight ramp is constant.  On a ramp from rest or to rest, the centre of
    rotation therefore does not move.  At a corner of the straight ramp, however, steering joints
    would have to reach their rate in zero time.  ``twist`` is therefore the mean of r over the last
    ``smoothing`` s.  ``smoothing`` is the time that steering joints need to reach their rate.  A
    ramp to zero is not smoothed: the wheels keep their directions, and the stop begins in the same
    tick.

    ``length`` is the lever (m) that converts angular to linear speed.
    """

    def __init__(self, settings: DriverSettings, length: float, smoothing: float) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self._length = length
        count = 1 + round(min(smoothing, LONGEST_SMOOTHING) * settings.rate)
        self._history = [ZERO_TWIST] * count

    def step(self, goal: Twist, dt: float) -> Twist:
        """Moves the ramp towards ``goal`` for ``dt`` s and returns the new twist."""
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
        """Limits the lead of the ramp over ``actual``, the twist of the wheels, to ``LEAD``.

        While wheels steer or are at their limits, the robot is slower than the ramp.  If the lead
        were not limited, the robot would accelerate abruptly as soon as the wheels are ready.

        ``aligned`` is ``False`` if wheels have to turn far.  If wheels have to turn far, the ramp
        only slows down and keeps its direction.  If the ramp moved towards the actual direction,
        the wheels that turn the long way because of a steering limit would turn back and never
        reach their target angles.
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
        """Scales the ramp down so that it leads the twist ``actual`` by at most ``LEAD``.

        The lead is measured along the direction of the ramp.
        """
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
        """Sets the ramp to ``twist``, as if the twist had been constant before."""
        self.twist = twist
        self._history = [twist] * len(self._history)


def _interpolate(a: Twist, b: Twist, share: float) -> Twist:
    return Twist(
        a.vx + share * (b.vx - a.vx), a.vy + share * (b.vy - a.vy), a.wz + share * (b.wz - a.wz)
    )
