"""Detects motors that do not follow their targets, for controllers that do not report it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from thorvaldc.runtime.can_base.motor_controller import STANDING, Axis

DEVIATION_TIME = 0.5
"""Time (s) for which a motor may deviate from its target, longer than ramps and delays."""
SPEED_DEVIATION_TIME = 0.1
"""Time (s) for which a wheel speed may match no target of the last ``DEVIATION_TIME``.

A bump in the ground disturbs the wheel speed for a shorter time."""
RELATIVE_DEVIATION, SPEED_DEVIATION = 0.5, 0.3
"""Largest deviation of a wheel speed: share of the target, or speed (rad/s) if this is more."""
ANGLE_DEVIATION = 0.2
"""Largest deviation (rad) of a standing steering joint from its target angle."""


class MotionSupervision:
    """Compares the measured motion of the motors of a controller with their targets.

    A wheel speed follows its target speed with a ramp and a delay.  A wheel speed is accepted if it
    is between the lowest and the highest target speed of the last ``DEVIATION_TIME`` seconds.  A
    steering joint deviates if it stands still and has not reached its target angle.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes
        self._deviating_since: dict[str, float] = {}
        """Start time (s) of the present deviation, by channel."""
        self._recent_targets: dict[str, deque[tuple[float, float]]] = {}

    @property
    def deviates(self) -> bool:
        """``True`` if a motor deviates now, even if not long enough for a problem."""
        return bool(self._deviating_since)

    @property
    def problems(self) -> list[str]:
        """A message for each motor that has deviated from its target for too long."""
        return [
            f"the {axis.channel} does not follow its target"
            for axis in self._axes
            if axis.time - self._deviating_since.get(axis.channel, math.inf) > DEVIATION_TIME
        ]

    def update(self, follows: bool, now: float) -> None:
        """Compares targets and measurements; called in each control cycle.

        ``follows``: ``True`` if the motors are powered and commanded to follow their targets.
        """
        for axis in self._axes:
            if not follows:
                self._deviating_since.pop(axis.channel, None)
                self._recent_targets.pop(axis.channel, None)
                continue
            since = axis.time
            if axis.steering:
                away = abs(axis.position - axis.target) > ANGLE_DEVIATION
                deviates = away and abs(axis.velocity) < STANDING
            else:
                targets = self._recent_targets.setdefault(axis.channel, deque())
                targets.append((now, axis.target))
                while targets[0][0] < now - DEVIATION_TIME:
                    targets.popleft()
                # The newest target is one of the targets, so that a speed near it is accepted.
                deviates = abs(axis.velocity - axis.target) > SPEED_DEVIATION and not _is_between(
                    axis.velocity, [speed for _, speed in targets]
                )
                # A deviation of a wheel speed may last only SPEED_DEVIATION_TIME, because all
                # target speeds of the last DEVIATION_TIME seconds are already accepted.
                since -= DEVIATION_TIME - SPEED_DEVIATION_TIME
            if deviates:
                self._deviating_since.setdefault(axis.channel, since)
            else:
                self._deviating_since.pop(axis.channel, None)


def _is_between(speed: float, targets: list[float]) -> bool:
    """Checks whether ``speed`` is between the lowest and the highest of ``targets`` (rad/s), with a
    tolerance."""
    lowest, highest = min(targets), max(targets)
    lowest -= max(RELATIVE_DEVIATION * abs(lowest), SPEED_DEVIATION)
    highest += max(RELATIVE_DEVIATION * abs(highest), SPEED_DEVIATION)
    return lowest <= speed <= highest
