"""Odometry of a simulated run over many ticks at once.

The joint commands of a driver do not depend on the odometry.  If nobody reads the odometry before
the end of a run, the joint states of the ticks are stored, and a few array operations estimate all
twists.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.odometry import LONGEST_INTERVAL, Odometry, mean_states
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.vectorised.calculator_batch import CalculatorBatch

_MOST_INTERVALS = 4096
"""Number of stored intervals after which the pose is integrated, to bound the memory."""


class _Interval(NamedTuple):
    """Interval between two ticks.

    - ``start``, ``end``: joint states of the ticks.  They are the same object if the joint states
      at the end are unusable.
    - ``duration``: time (s) between the ticks.
    - ``calculator``: calculator of the interval.
    - ``speeds``: last commanded wheel speeds (rad/s), or ``None``.
    """

    start: JointStates
    end: JointStates
    duration: float
    calculator: BaseCalculator
    speeds: Sequence[float] | None


class DeferredOdometry(Odometry):
    """An odometry that integrates the pose of a simulated robot only in ``finish``.

    After ``finish``, ``pose`` is equal to the last bit to the pose of an ``Odometry`` that was
    updated in each tick, and ``path`` is the length (m) of the estimated path.  There is no
    estimate of a single tick and no covariance.
    """

    def __init__(self, odometry: Odometry) -> None:
        """Takes the place of ``odometry``, which has no joint states yet."""
        super().__init__(odometry.calculator, odometry.top_speeds)
        self.path = 0.0
        self._twist = self.estimate.twist
        self._intervals: list[_Interval] = []

    @staticmethod
    def suits(calculator: BaseCalculator, period: float, timestep: float) -> bool:
        """Returns whether the odometry of a run can be deferred.

        - ``period``: time (s) between two ticks.  Each interval must have new joint states, and
          must be well within the longest interval of the odometry.
        - ``timestep``: time (s) between two joint states of the simulation.
        """
        own_odometry = type(calculator).odometry is not BaseCalculator.odometry
        return not own_odometry and 2.0 * timestep <= period <= LONGEST_INTERVAL / 2.0

    def update(self, joints: JointStates, now: float) -> None:
        """Stores the joint states of a tick at ``now`` (s).

        The joint states have positions and no yaw rate.  Raises ``ValueError`` if they are
        unusable.
        """
        if self.joints is None:
            super().update(joints, now)
            self._twist = self.estimate.twist
            return
        self.calculator.estimator.check(joints)
        self._add(self.joints, joints, now)

    def mark_missing(self, now: float) -> None:
        """Stores that the joint states at ``now`` (s) are missing."""
        if self.joints is not None:
            self._add(self.joints, self.joints, now)

    def _add(self, start: JointStates, end: JointStates, now: float) -> None:
        calculator = self.calculator
        duration, speeds = now - self._time, calculator.commanded_speeds
        self._intervals.append(_Interval(start, end, duration, calculator, speeds))
        self.joints = calculator.checked_states = end
        self._time = now
        if len(self._intervals) == _MOST_INTERVALS:
            self.finish()

    def finish(self) -> None:
        """Integrates the pose and the path to the last tick."""
        intervals, self._intervals = self._intervals, []
        for _, group in groupby(intervals, lambda i: (id(i.calculator), i.start is i.end)):
            group_intervals = list(group)
            twists = _twists(group_intervals)
            for interval, twist in zip(group_intervals, twists, strict=True):
                if twist is not None:
                    elapsed = interval.end.time - interval.start.time
                    self.pose = self.pose.moved(se2.exp(twist, elapsed))
                    self._twist = twist
                self.path += self._twist.speed * interval.duration


def _twists(intervals: Sequence[_Interval]) -> Sequence[Twist | None]:
    """Returns the estimated twist of each interval, or ``None`` without usable joint states.

    The calculators of the intervals are the same, and each interval starts at the end of the
    previous one.
    """
    first = intervals[0]
    if first.start is first.end:
        return [None] * len(intervals)
    states = [first.start, *(interval.end for interval in intervals)]
    positions = np.array([joints.positions for joints in states]).T
    angles = np.array([joints.angles for joints in states]).T
    times = np.array([joints.time for joints in states])
    elapsed = times[1:] - times[:-1]
    twists = np.empty((3, len(intervals)))
    try:
        CalculatorBatch(first.calculator, as_scalar=True).estimate(
            (positions[:, 1:] - positions[:, :-1]) / elapsed,
            (angles[:, :-1] + angles[:, 1:]) / 2.0,
            twists,
            rates=(angles[:, 1:] - angles[:, :-1]) / elapsed,
            commanded=lambda i: intervals[i].speeds,
        )
    except ValueError:
        # In a diverged simulation the joint states of the last tick are out of all bounds.
        return [_twist(interval) for interval in intervals]
    return [Twist(*twist) for twist in twists.T.tolist()]


def _twist(interval: _Interval) -> Twist | None:
    elapsed = interval.end.time - interval.start.time
    states = mean_states(interval.start, interval.end, elapsed)
    try:
        return interval.calculator.estimator.estimate(states, interval.speeds).twist
    except ValueError:
        return None
