"""The twist on its way to the one asked for: within the accelerations, and smoothly."""

from __future__ import annotations

import math

from thorvaldc.model import DriverSettings
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

LEAD = 0.1
"""Speed (m/s, of the wheels) by which the ramp may be ahead of what the wheels do."""
LONGEST_SMOOTHING = 0.5
"""Time (s) over which a ramp is smoothed at the most."""


class Ramp:
    """Straight in the space of twists: from rest and to rest the centre of rotation stays.

    A straight ramp has corners: where it begins, wheels that steer along with it would have to
    turn at their rate at once.  ``twist`` is its mean over the last ``smoothing`` s, the time
    in which steering reaches its rate, so that wheels can follow and keep agreeing.  On the
    way to rest they keep their directions, and nothing is smoothed: a stop begins at once.
    ``length`` (m) is the lever between linear and angular speed.
    """

    def __init__(self, settings: DriverSettings, length: float, smoothing: float) -> None:
        self.settings = settings
        self.twist = ZERO_TWIST
        self._length = length
        count = 1 + round(min(smoothing, LONGEST_SMOOTHING) * settings.rate)
        self._corners = [ZERO_TWIST] * count

    def step(self, goal: Twist, dt: float) -> Twist:
        """Go on for ``dt`` s towards ``goal``."""
        corners = self._corners
        if goal == ZERO_TWIST:
            if self.twist != ZERO_TWIST:
                self.restart(self._straight(self.twist, goal, dt))
            return self.twist
        now = corners[-1]
        if goal == now:
            if corners[0] == now and corners.count(now) == len(corners):
                self.twist = now  # exactly, where a mean of many may round
                return now
            after = now
        else:
            after = self._straight(now, goal, dt)
        del corners[0]
        corners.append(after)
        n = len(corners)
        vx, vy, wz = map(sum, zip(*corners, strict=True))
        self.twist = Twist(vx / n, vy / n, wz / n)
        return self.twist

    def _straight(self, now: Twist, goal: Twist, dt: float) -> Twist:
        """``dt`` s further towards ``goal``, at what the accelerations allow."""
        settings, share = self.settings, 1.0
        dv = math.hypot(goal.vx - now.vx, goal.vy - now.vy)
        dw = abs(goal.wz - now.wz)
        if dv > settings.max_linear_acceleration * dt:
            share = settings.max_linear_acceleration * dt / dv
        if dw * share > settings.max_angular_acceleration * dt:
            share = settings.max_angular_acceleration * dt / dw
        return goal if share >= 1.0 else _between(now, goal, share)

    def draw_back(self, doing: Twist, aligned: bool = True) -> None:
        """Be no further than ``LEAD`` ahead of what the wheels do.

        Wheels that still turn, or are at their limits, make the robot slower than
        the ramp; without this it would jump once they are through.  Where wheels have far to
        turn (not ``aligned``) the direction stays: drawn to theirs, it would call back wheels
        that turn the long way round, past a limit of their steering, and they never arrive.
        """
        vx, vy, wz = self.twist
        if not aligned:
            self._slow_down(doing)
            return
        dx, dy, dw = vx - doing.vx, vy - doing.vy, self._length * (wz - doing.wz)
        ahead = dx * dx + dy * dy + dw * dw
        if ahead <= LEAD * LEAD:
            return
        share = LEAD / math.sqrt(ahead)
        self.twist = _between(doing, self.twist, share)
        self._corners = [_between(doing, corner, share) for corner in self._corners]

    def _slow_down(self, doing: Twist) -> None:
        vx, vy, wz = self.twist
        lever = self._length * self._length
        size = math.sqrt(vx * vx + vy * vy + lever * wz * wz)
        if size <= LEAD:
            return
        along = (vx * doing.vx + vy * doing.vy + lever * wz * doing.wz) / size
        share = (max(along, 0.0) + LEAD) / size
        if share < 1.0:
            self.twist = self.twist.scaled(share)
            self._corners = [corner.scaled(share) for corner in self._corners]

    def restart(self, twist: Twist) -> None:
        """Be at ``twist``, as if it had been so for long."""
        self.twist = twist
        self._corners = [twist] * len(self._corners)


def _between(a: Twist, b: Twist, share: float) -> Twist:
    return Twist(
        a.vx + share * (b.vx - a.vx), a.vy + share * (b.vy - a.vy), a.wz + share * (b.wz - a.wz)
    )
