"""Groups of equal robots in one scene, whose odometry is computed in one batch per tick."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.driver import BaseDriver

if TYPE_CHECKING:
    from thorvaldc.simulation.vectorised.odometry_batch import OdometryBatch

MIN_GROUP_SIZE = 32
"""Number of equal robots from which array operations are faster than a loop over the robots."""


class RobotGroups:
    """Finds groups of equal robots and updates the odometry of each group with arrays.

    Each robot keeps its own driver. The driver's tick then finds its odometry updated and does
    the rest. ``groups`` lists, per group, the indices of its robots and their batch.
    """

    def __init__(self, drivers: Sequence[BaseDriver]) -> None:
        robots_by_key: dict[Hashable, list[int]] = {}
        for index, driver in enumerate(drivers):
            key = _group_key(driver.calculator)
            if key is not None:
                robots_by_key.setdefault(key, []).append(index)
        self._drivers = drivers
        self._calculators = [driver.calculator for driver in drivers]
        self.groups: list[tuple[list[int], OdometryBatch]] = []
        for indices in robots_by_key.values():
            if len(indices) >= MIN_GROUP_SIZE:
                # Imports numpy, which a scene with few robots does not need.
                from thorvaldc.simulation.vectorised.odometry_batch import OdometryBatch

                odometries = [drivers[i].odometry for i in indices]
                batch = OdometryBatch(self._calculators[indices[0]], odometries)
                self.groups.append((indices, batch))

    def update_odometry(self, now: float, due: Sequence[int]) -> dict[int, JointStates]:
        """Read the joints of each group whose robots are all ``due``, and update their odometry.

        Returns the joint states by robot index, for the drivers' ticks. The batch leaves out
        robots with unusual joint states; their drivers update the odometry themselves.
        """
        joints_by_robot: dict[int, JointStates] = {}
        for indices, batch in self.groups:
            # A parameter change exchanges the calculator: the robots are no longer equal.
            if not set(indices) <= set(due) or any(
                self._drivers[i].calculator is not self._calculators[i] for i in indices
            ):
                continue
            joints = [self._drivers[i].base.read(now) for i in indices]
            batch.update(joints, now)
            joints_by_robot.update(zip(indices, joints, strict=True))
        return joints_by_robot


def _group_key(calculator: BaseCalculator) -> Hashable | None:
    """Key that is equal for robots that one batch can serve; ``None``: no batch can.

    The batch needs the estimator's odometry and wheels that determine the whole twist at any
    steering angles.
    """
    estimator = calculator.estimator
    overrides_odometry = type(calculator).odometry is not BaseCalculator.odometry
    if overrides_odometry or estimator.inverse is None or estimator.inverse[1] < 3:
        return None
    return calculator.geometry, estimator.noise, estimator.options
