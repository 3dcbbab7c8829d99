"""What the velocity smoother and the collision monitor of Nav2 send for commands of a controller.

The rules are those of ``smootherTimer`` and ``publishVelocity`` in the sources that nav2.yaml
names, along x only.  Stamps are times (s) of the partner's clock; 0 is a stamp of zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

OWN_PARAMETERS = {
    "smoothing_frequency": 20.0,
    "max_velocity": [0.5, 0.0, 2.0],
    "max_accel": [2.5, 0.0, 3.2],
    "max_decel": [-2.5, 0.0, -3.2],
    "velocity_timeout": 1.0,
    "stop_pub_timeout": 2.0,
}
"""nav2_bringup/params/nav2_params.yaml of Jazzy and Kilted."""
SMOOTHED, MONITORED = 0.04, 1e-3
"""Time (s) from the controller to the smoother, which runs 0.04 s later; tolerance."""


class Nav2:
    """``clock``: function that returns the partner's time (s) at a time of the script (s)."""

    def __init__(self, parameters: Mapping[str, Any], clock: Callable[[float], float]) -> None:
        self.period = 1.0 / parameters["smoothing_frequency"]
        self._rise = parameters["max_accel"][0] * self.period
        self._fall = -parameters["max_decel"][0] * self.period
        self._highest = parameters["max_velocity"][0]
        self._timeout = parameters["velocity_timeout"]
        self._longest_zeros = parameters["stop_pub_timeout"]
        self._clock = clock
        self._command: tuple[float, float] | None = None  # speed, stamp
        self._heard_at = 0.0
        self._last = 0.0
        self._stopped = True
        self._sent, self._stopped_at = -1.0, -math.inf  # of the collision monitor

    def command(self, speed: float, stamp: float, at: float) -> None:
        """The controller commands a speed."""
        self._command = (speed, stamp)
        self._heard_at = stamp or self._clock(at)

    def smooth(self, at: float) -> tuple[float, float] | None:
        """Returns the speed and the stamp that the smoother sends, or ``None``."""
        if self._command is None:
            return None
        now = self._clock(at)
        speed, stamp = self._command
        if now - self._heard_at > self._timeout + MONITORED:
            if self._last == 0.0 or self._stopped:
                self._stopped = True
                return None
            speed, self._command = 0.0, (0.0, now)
        self._stopped = False
        target = min(max(speed, -self._highest), self._highest)
        rises = abs(target) >= abs(self._last) and self._last * target >= 0.0
        step = self._rise if rises else self._fall
        self._last += min(max(target - self._last, -step), step)
        return self._last, stamp

    def monitor(self, speed: float, free: bool, at: float) -> float | None:
        """Returns the speed that the collision monitor sends, or ``None``.

        ``free``: nothing is in the way, and the lidar is heard.
        """
        speed, last, now = (speed if free else 0.0), self._sent, self._clock(at)
        self._sent = speed
        if speed == 0.0 and last != 0.0:
            self._stopped_at = now
        elif speed == 0.0 and now - self._stopped_at > self._longest_zeros:
            return None
        return speed
