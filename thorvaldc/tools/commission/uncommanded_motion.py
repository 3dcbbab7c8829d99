r"""Notices that a motor turns which nobody commands.

After a motion, a motor brakes, or coasts without torque.  A motor that does neither is driven by
something else::

    speed |___                 a motor that stops loses SLOWING of its speed in each PATIENCE
          |   \_____________   this one does not: it turns by itself, or its reports are frozen
          |    \___
          |        \______
          +-------------------------> time since the end of the command
"""

from __future__ import annotations

import math

from thorvaldc.runtime.can_base.motor_controller import FRESH
from thorvaldc.runtime.motion_supervision import STANDING, Axis

PATIENCE = 0.5
"""Time (s) in which a motor must slow down, and at least ``CYCLES`` control cycles."""
CYCLES = 5
SLOWING = 0.1
"""Share of its speed that a motor loses at least in ``PATIENCE``."""
TRAVEL = 0.1
"""Travel (rad) up to which a motor may turn: a touch, play or vibration."""


class UncommandedMotion:
    """Judges the motion of one motor in each control cycle.

    - ``axis``: the motor; ``period``: control cycle (s).
    """

    def __init__(self, axis: Axis, period: float) -> None:
        self.axis = axis
        self._patience = max(PATIENCE, CYCLES * period)
        self._fresh = max(FRESH, 2.0 * period)
        self._updated_at = math.nan
        self.forget()

    def forget(self) -> None:
        """Begins anew, as for a motor that stands."""
        self._since = math.inf
        """Time (s) since which the motor has not slowed down."""
        self._fastest = math.inf
        """Highest speed (rad/s) since then."""
        self._travel = 0.0

    def update(self, now: float, commanded: bool) -> bool:
        """Returns ``True`` if the motor turns although it is not ``commanded`` to turn."""
        axis, speed = self.axis, abs(self.axis.velocity)
        elapsed, self._updated_at = now - self._updated_at, now
        if commanded or now - axis.time > self._fresh or not speed > STANDING:
            self.forget()
        elif speed < (1.0 - SLOWING) * self._fastest:
            self._since, self._fastest, self._travel = now, speed, 0.0
        else:
            self._fastest = max(self._fastest, speed)
            self._travel += axis.velocity * elapsed
        return now - self._since > self._patience and abs(self._travel) > TRAVEL
