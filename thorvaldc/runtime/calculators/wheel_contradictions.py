"""Wheels that contradict their commands, as one of the causes in ``wheel_causes`` makes them do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from thorvaldc.runtime.calculators.twist_fit import (
    TEST_ROLL,
    USE_ROLL,
    Fit,
    Measurement,
    rolling_leverage,
    rolling_speed,
)

_FOLLOWING: Final = 0.03
"""Error of a wheel that follows its command, relative to the commanded speed."""
FOLLOWING_FLOOR: Final = 0.015
"""Error (m/s) of a wheel that follows its command, in addition to the relative error.

A wheel that accelerates by 0.75 m/s^2 is so much slower than its command of the last tick.
"""
COMMANDED_SPEED: Final = 0.05
"""Commanded speed (m/s) from which a reading is a share of the command."""
DOUBTFUL: Final = 0.4
"""Deviation from the command, relative to the command, that no load or delay explains."""
_COMMON_LAG: Final = 0.1
"""Largest difference of the shares of their commands that wheels with a common lag reach."""
_COMMON_LAG_UNCONFIRMED: Final = 0.03
"""The same for wheels whose speeds no other wheel confirms: the error goes unseen."""
_EQUAL_SHARES: Final = 0.1
"""Largest difference between the shares of their commands that encoders with one cause read."""
_EQUAL_READINGS: Final = 0.005
"""Largest difference (m/s) between the readings of encoders with one cause."""
_STANDING: Final = 0.005
"""Speed (m/s) below which a wheel stands."""
_UNCONFIRMED: Final = 0.75
"""Share of a measured speed in its own estimate from which no other wheel confirms it."""


def following_error(speed: float) -> float:
    """Returns the largest error (m/s) of a wheel that follows its commanded speed (m/s)."""
    return FOLLOWING_FLOOR + _FOLLOWING * abs(speed)


def encoders(measurements: Sequence[Measurement]) -> tuple[int, ...]:
    """Returns the indices of the measurements with an encoder that the fit may use."""
    return tuple(k for k, m in enumerate(measurements) if m[0] & USE_ROLL)


class Contradiction(NamedTuple):
    """Wheels that contradict their commands.

    - ``wheels``: indices of the measurements of these wheels, N.
    - ``commands``: commanded rolling speed (m/s) of the contact of each measured wheel, or empty if
      the commands are unknown.
    - ``causes``: least number of causes that the encoders of N have, if they are wrong.
    - ``pushed``: number of wheels that turn, as others confirm, although they should stand.
    - ``doubtful``: ``True`` if no load, delay or push explains the deviations.
    """

    wheels: tuple[int, ...]
    commands: Sequence[float]
    causes: int
    pushed: int
    doubtful: bool


def contradiction(
    fit: Fit, measurements: Sequence[Measurement], turning: Sequence[tuple[float, float]]
) -> Contradiction:
    """Returns the wheels that contradict their commands; without commands, those that stand.

    - ``fit``: fitted twist with all measurements.
    - ``turning``: measured and commanded speed (m/s) of each measured wheel, or empty if the
      commands are unknown.
    """
    if not turning:
        standing = [k for k in encoders(measurements) if abs(measurements[k][5]) < _STANDING]
        return Contradiction(tuple(standing), (), 1, 0, False)
    wheels: list[int] = []
    shares: list[float] = []
    readings: list[float] = []
    pushed, doubtful, highest, lowest = 0, False, -math.inf, math.inf
    common = _COMMON_LAG
    untested, stops, alike = False, False, True
    every = encoders(measurements)
    for k in every:
        measured, command = turning[k]
        follows = abs(measured - command) <= following_error(command)
        share = measured / command if abs(command) > COMMANDED_SPEED and not follows else 1.0
        highest, lowest = max(highest, share), min(lowest, share)
        if follows:
            continue
        wheels.append(k)
        confirmed = rolling_leverage(fit, k) <= _UNCONFIRMED
        if not (confirmed and measurements[k][0] & TEST_ROLL):
            untested, common = True, _COMMON_LAG_UNCONFIRMED
            rolls = rolling_speed(fit, k)
            doubtful = doubtful or abs(measured - rolls) > following_error(rolls)
        if abs(command) <= COMMANDED_SPEED:
            pushed += confirmed
            stops = True
            alike = alike and abs(measured - turning[every[0]][0]) < FOLLOWING_FLOOR
            continue
        doubtful = doubtful or abs(share - 1.0) > DOUBTFUL
        if confirmed:
            _add_distinct(shares, share, _EQUAL_SHARES)
            _add_distinct(readings, measured, _EQUAL_READINGS)
    commands = [
        # The contact of a wheel beside its steering axis also moves with the steering joint.
        m[5] + command - measured
        for m, (measured, command) in zip(measurements, turning, strict=True)
    ]
    causes = max(pushed + min(len(shares), len(readings)), 1)
    doubtful = doubtful or highest - lowest > common
    # A push turns all wheels, and two wheels alike.  Nothing confirms a single one.
    no_push = len(wheels) < len(every) or not (pushed or alike)
    if untested and (len(every) == 1 or (stops and no_push)):
        doubtful = True
    return Contradiction(tuple(wheels), commands, causes, pushed, doubtful)


def _add_distinct(values: list[float], value: float, tolerance: float) -> None:
    if all(abs(value - other) > tolerance for other in values):
        values.append(value)
