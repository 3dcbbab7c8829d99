"""Warnings about wheels whose measurements the odometry leaves out or doubts for some time."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from thorvaldc.runtime.calculators import TwistEstimate

_TIME_CONSTANT = 2.0
"""Time constant (s) of the share of time in which a wheel is left out or doubted."""
_WARNED_SHARE = 0.5
"""Share of the time from which a warning is raised.

Healthy wheels fail their tests in 1 % of the ticks; a faulty wheel that moves fails in most.
"""
_FORGOTTEN_SHARE = 0.001


class WheelWarnings:
    """Collects the results of the wheel tests over time.

    A share s of the time with the value x (0 or 1) in a tick of dt s changes by (x - s) dt / (tau +
    dt), where tau is the time constant.
    """

    def __init__(self) -> None:
        self._dropped: dict[int, float] = {}
        self._suspects: dict[int, float] = {}
        self._time = math.inf

    def update(self, estimate: TwistEstimate, time: float) -> None:
        """Adds the estimate of a tick with joint states that were measured at ``time`` (s)."""
        if estimate.dropped or estimate.suspects or self._dropped or self._suspects:
            elapsed = max(time - self._time, 0.0)
            gain = elapsed / (_TIME_CONSTANT + elapsed)
            _update(self._dropped, estimate.dropped, gain)
            _update(self._suspects, estimate.suspects, gain)
        self._time = time

    def texts(self, names: Sequence[str]) -> list[str]:
        """Returns the present warnings for an operator; ``names``: names of all wheels."""
        warnings = []
        if dropped := _lasting(self._dropped):
            wheels = ", ".join(names[i] for i in dropped)
            warnings.append(
                f"odometry: left out {wheels}: the speed or direction disagrees with the other"
                " wheels or with the command; check the encoders"
            )
        if suspects := [i for i in _lasting(self._suspects) if i not in dropped]:
            wheels = ", ".join(names[i] for i in suspects)
            warnings.append(
                f"odometry: the encoders of {wheels} may be wrong, or the wheels do not follow"
                " their commands; the covariance covers both cases"
            )
        return warnings


def _update(shares: dict[int, float], wheels: Collection[int], gain: float) -> None:
    for wheel in {*shares, *wheels}:
        share = shares.get(wheel, 0.0)
        shares[wheel] = share + gain * (float(wheel in wheels) - share)
        if shares[wheel] < _FORGOTTEN_SHARE and wheel not in wheels:
            del shares[wheel]


def _lasting(shares: dict[int, float]) -> list[int]:
    return sorted(wheel for wheel, share in shares.items() if share > _WARNED_SHARE)
