"""Groups the identical robots of a scene, and computes the odometry of each group as a batch."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.driver import BaseDriver

if TYPE_CHECKING:
    from thorvaldc.simulation.vectorised.odometry_batch import OdometryBatch

MIN_GROUP_SIZE = 32
"""Smallest group of robots for which array operations are faster than a loop over the robots."""


class RobotGroups:
    """Groups of identical robots, whose odometry is updated with array operations.

    Each robot keeps its own driver.  The odometry of a robot is updated before the tick of its
    driver.  The attribute ``groups`` contains, for each group, the indices of the robots and their
    ``OdometryBatch``.
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
                # The module odometry_batch imports numpy, which a scene with few robots does not
                # need.
                from thorvaldc.simulation.vectorised.odometry_batch import OdometryBatch

                odometries = [drivers[i].odometry for i in indices]
                batch = OdometryBatch(self._calculators[indices[0]], odometries)
                self.groups.append((indices, batch))

    def update_odometry(self, now: float, due: Sequence[int]) -> dict[int, JointStates]:
        """Reads the joints of the robots in each group and updates their odometry.

        ``due`` contains the indices of the robots whose drivers run a tick at ``now`` (s).  A group
        is left out if a robot of the group is not in ``due``.  Returns the joint states by the
        index of the robot, for the ticks of the drivers.  The batch leaves out robots with unusual
        joint states, and the drivers of these robots update the odometry.
        """
        joints_by_robot: dict[int, JointStates] = {}
        for indices, batch in self.groups:
            # A parameter change replaces the base calculator of a robot, so the robots of a group
            # may no longer be identical.
            if not set(indices) <= set(due) or any(
                self._drivers[i].calculator is not self._calculators[i] for i in indices
            ):
                continue
            joints = [self._drivers[i].base.read(now) for i in indices]
            batch.update(joints, now)
            joints_by_robot.update(zip(indices, joints, strict=True))
        return joints_by_robot


def _group_key(calculator: BaseCalculator) -> Hashable | None:
    """Returns a key that is equal for robots of the same group, or ``None`` without a batch.

    A batch of robots is possible only if the calculator uses the method ``BaseCalculator.odometry``
    without changes, and if the wheels determine the whole twist at any steering angles.
    """
    estimator = calculator.estimator
    overrides_odometry = type(calculator).odometry is not BaseCalculator.odometry
    if overrides_odometry or estimator.inverse is None or estimator.inverse[1] < 3:
        return None
    return calculator.geometry, estimator.noise, estimator.options
