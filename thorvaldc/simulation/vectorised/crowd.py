"""Robots of one kind in one scene, whose joints are taken in together."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.driver import BaseDriver

if TYPE_CHECKING:
    from thorvaldc.simulation.vectorised.odometry_batch import OdometryBatch

LEAST = 32
"""Robots of a kind from which arrays are faster than one robot after the other."""


class Crowd:
    """Reads the bases of robots of which there are many, and does their odometry at once.

    Each keeps its own driver, whose tick then goes on from there.  ``kinds``: the numbers of the
    robots of each kind of which there are many, and what does their odometry.
    """

    def __init__(self, drivers: Sequence[BaseDriver]) -> None:
        kinds: dict[Hashable, list[int]] = {}
        for number, driver in enumerate(drivers):
            kind = _kind(driver.calculator)
            if kind is not None:
                kinds.setdefault(kind, []).append(number)
        self._drivers = drivers
        self._calculators = [driver.calculator for driver in drivers]
        self.kinds: list[tuple[list[int], OdometryBatch]] = []
        for numbers in kinds.values():
            if len(numbers) >= LEAST:
                from thorvaldc.simulation.vectorised.odometry_batch import (
                    OdometryBatch,  # and numpy
                )

                odometries = [drivers[k].odometry for k in numbers]
                batch = OdometryBatch(self._calculators[numbers[0]], odometries)
                self.kinds.append((numbers, batch))

    def sense(self, now: float, due: Sequence[int]) -> dict[int, JointStates]:
        """Read those of which there are many, if all of a kind are ``due``.

        Their joints by number, taken in by their odometry where that is usual.
        """
        found: dict[int, JointStates] = {}
        for numbers, batch in self.kinds:
            # With other parameters, robots are of a kind no more.
            if not set(numbers) <= set(due) or any(
                self._drivers[k].calculator is not self._calculators[k] for k in numbers
            ):
                continue
            joints = [self._drivers[k].base.read(now) for k in numbers]
            batch.update(joints, now)
            found.update(zip(numbers, joints, strict=True))
        return found


def _kind(calculator: BaseCalculator) -> Hashable | None:
    """Equal for robots whose odometry can be done together; ``None``: only by itself."""
    estimator = calculator.estimator
    own = type(calculator).odometry is not BaseCalculator.odometry
    if own or estimator.inverse is None or estimator.inverse[1] < 3:
        return None
    return calculator.geometry, estimator.noise, estimator.options
