"""Odometry over arrays of joint states: of many states, of many robots, of many ticks.

All arrays have the type float64, one row per component, and one column per state of the robot.
Twists have the shape (3, n) with the rows vx, vy and wz of ``base_link`` (m/s, m/s, rad/s).  Joint
values have the shape (wheels, n), in the order of the robot's wheels.  The methods write their
results into arrays that the caller has allocated.  The input arrays are processed in pieces of
columns that fit into the cache of a processor core.  No additional array of the size of the input
is allocated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates, NotFiniteError
from thorvaldc.runtime.calculators import BaseCalculator, TwistEstimate
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimator
from thorvaldc.runtime.odometry import LONGEST_INTERVAL, Odometry, mean_states
from thorvaldc.runtime.se2 import Cov3, Pose2, Turn, Twist, propagated
from thorvaldc.simulation.vectorised import fit_batch

Array = NDArray[np.float64]
_PIECE_SIZE = 8192
"""Number of array columns that are processed at a time."""
_GATE_TOLERANCE = 1e-6
"""Relative difference of a chi-square from its limit within which rounding errors may decide."""
MAX_VALUE = 1e9
"""Twists and joint states (SI units) with an absolute value from this limit on are rejected."""


class CalculatorBatch:
    """Estimates twists for arrays of joint states.

    The results equal the results of the scalar calculator to 1e-12.  With ``as_scalar``, twists are
    equal to the last bit, and take longer.
    """

    def __init__(self, calculator: BaseCalculator, *, as_scalar: bool = False) -> None:
        self.calculator = calculator
        self._as_scalar = as_scalar
        self.wheels = len(calculator.geometry.wheels)

    def estimate(
        self,
        speeds: Array,
        angles: Array,
        twists: Array,
        covariances: Array | None = None,
        chi_squares: Array | None = None,
        rates: Array | None = None,
        yaw_rates: Array | None = None,
        commanded: Callable[[int], Sequence[float] | None] | None = None,
        suspects: dict[int, tuple[int, ...]] | None = None,
    ) -> dict[int, tuple[int, ...]]:
        """Estimates twists without faulty wheels, as ``TwistEstimator.estimate`` does.

        - ``speeds``: wheel speeds, rad/s.
        - ``angles``: steering angles, rad.
        - ``twists``: array for the resulting twists.
        - ``covariances``: array (6, n) for the elements xx, xy, xw, yy, yw and ww of the twist's
          covariance, in SI units.
        - ``chi_squares``: array (wheels, n) for the chi-squares.
        - ``rates``: steering rates, rad/s.  Steering rates affect only wheels whose contact lies
          beside, ahead of or behind the steering axis.
        - ``yaw_rates``: yaw rates (n) measured by a gyro, rad/s.
        - ``commanded``: returns the commanded wheel speeds (rad/s) of an array column, if they are
          known.
        - ``suspects``: receives the indices of the wheels that may be faulty, for each column with
          such wheels.

        Returns a dictionary with the indices of the faulty wheels, for each column with faulty
        wheels.  The scalar estimator computes the few columns in which a wheel disagrees with the
        other wheels or with its command.  With the option ``faulty`` = 0 no wheel is left out.

        Raises ``ValueError`` if an array has the wrong shape, and ``NotFiniteError`` if a joint
        state is not finite or not below 1e9.
        """
        n = self._check_joints(speeds, angles, twists, rates)
        if covariances is not None:
            _check(covariances, (6, n))
        if chi_squares is not None:
            _check(chi_squares, (self.wheels, n))
        if yaw_rates is not None:
            _check(yaw_rates, (n,))
            _check_finite(yaw_rates, "yaw rates")
        estimator = self.calculator.estimator
        reject = estimator.options.faulty > 0
        gates = np.array(estimator.gates)[:, np.newaxis]
        if self._as_scalar:
            # The chi-squares have rounding errors, and the scalar estimator decides on close ones.
            gates *= 1.0 - _GATE_TOLERANCE
        dropped: dict[int, tuple[int, ...]] = {}
        tests = np.empty((len(estimator.wheels), min(n, _PIECE_SIZE)))
        for piece in _pieces(n):
            joints = _piece(speeds, angles, rates, piece)
            gyro = None if yaw_rates is None else yaw_rates[piece]
            measurements = fit_batch.measure(estimator, *joints, as_scalar=self._as_scalar)
            size = piece.stop - piece.start
            twist, scalar_mask = fit_batch.unweighted_fit(estimator, measurements, gyro, size)
            for _ in range(1 + estimator.options.polish):
                fit = fit_batch.fit_twists(estimator, measurements, twist, gyro)
                twist = fit.twist
            self._put_twist(twist, twists[:, piece])
            if covariances is not None:
                self._put_covariance(fit.covariance, covariances[:, piece])
            if chi_squares is not None or reject:
                fit_batch.chi_squares(fit, tests[:, :size])
            if chi_squares is not None:
                chi_squares[:, piece] = 0.0
                chi_squares[[wheel.number for wheel in estimator.wheels], piece] = tests[:, :size]
            if reject:
                suspect: NDArray[np.bool_] = np.any(tests[:, :size] > gates, axis=0)
                if commanded is not None:
                    suspect |= _deviating(estimator, speeds[:, piece], piece, commanded)
                scalar_mask = suspect if scalar_mask is None else suspect | scalar_mask
            for k in _indices(scalar_mask):
                index = piece.start + k
                wheel_commands = None if commanded is None else commanded(index)
                estimate = estimator.estimate(_state(*joints, gyro, k), wheel_commands)
                twists[:, index] = estimate.twist
                if covariances is not None:
                    (a, b, c), (_, d, e), (_, _, f) = estimate.covariance
                    covariances[:, index] = a, b, c, d, e, f
                if chi_squares is not None:
                    chi_squares[:, index] = estimate.chi_squares
                if estimate.dropped:
                    dropped[index] = estimate.dropped
                if estimate.suspects and suspects is not None:
                    suspects[index] = estimate.suspects
        return dropped

    def _put_twist(self, twist: tuple[Array, Array, Array], out: Array) -> None:
        """Writes twists of ``base_link`` into ``out``, computed from twists about the centroid."""
        vx, vy, wz = twist
        xm, ym = self.calculator.geometry.centre
        np.add(vx, ym * wz, out=out[0])
        np.subtract(vy, xm * wz, out=out[1])
        out[2] = wz

    def _put_covariance(self, covariance: tuple[Array, ...], out: Array) -> None:
        p11, p12, p13, p22, p23, p33 = covariance
        xm, ym = self.calculator.geometry.centre
        out[0] = p11 + 2.0 * ym * p13 + ym * ym * p33
        out[1] = p12 + ym * p23 - xm * p13 - xm * ym * p33
        out[2] = p13 + ym * p33
        out[3] = p22 - 2.0 * xm * p23 + xm * xm * p33
        out[4] = p23 - xm * p33
        out[5] = p33

    def _check_joints(
        self, speeds: Array, angles: Array, twists: Array, rates: Array | None
    ) -> int:
        n = self._size(twists)
        for array, quantity in ((speeds, "speeds"), (angles, "angles"), (rates, "rates")):
            if array is not None:
                _check(array, (self.wheels, n))
                _check_finite(array, quantity)
        return n

    def _size(self, twists: Array) -> int:
        n = twists.shape[-1] if twists.ndim else 0
        _check(twists, (3, n))
        return n


def _pieces(n: int) -> Iterator[slice]:
    for start in range(0, n, _PIECE_SIZE):
        yield slice(start, min(start + _PIECE_SIZE, n))


def _check(array: Array, shape: tuple[int, ...]) -> None:
    if array.shape != shape or array.dtype != np.float64:
        raise ValueError(f"an array of {array.dtype} {array.shape}; expected float64 {shape}")


def _check_finite(array: Array, quantity: str) -> None:
    if not array.size or max(float(array.max()), -float(array.min())) < MAX_VALUE:
        return
    if not np.isfinite(array).all():
        raise NotFiniteError(f"the {quantity} are not all finite")
    raise NotFiniteError(f"the {quantity} are not all below {MAX_VALUE:g}")


def _piece(
    speeds: Array, angles: Array, rates: Array | None, piece: slice
) -> tuple[Array, Array, Array | None]:
    return speeds[:, piece], angles[:, piece], None if rates is None else rates[:, piece]


def _deviating(
    estimator: TwistEstimator,
    speeds: Array,
    piece: slice,
    commanded: Callable[[int], Sequence[float] | None],
) -> NDArray[np.bool_]:
    """Returns in which columns a wheel may deviate from its command (rad/s)."""
    rows = [commanded(k) for k in range(piece.start, piece.stop)]
    none = [0.0] * len(speeds)
    commands = np.array([none if row is None else row for row in rows]).T
    deviating: NDArray[np.bool_] = np.abs(speeds - commands) > estimator.least_deviation
    deviating &= np.abs(commands) > estimator.least_command
    result: NDArray[np.bool_] = np.any(deviating, axis=0)
    return result


def _indices(mask: NDArray[np.bool_] | None) -> list[int]:
    return [] if mask is None else [int(k) for k in np.flatnonzero(mask)]


def _state(
    speeds: Array, angles: Array, rates: Array | None, yaw_rates: Array | None, k: int
) -> JointStates:
    """Returns the joint states in the array column ``k`` for the scalar estimator."""
    turning = [0.0] * len(speeds) if rates is None else rates[:, k].tolist()
    yaw_rate = None if yaw_rates is None else float(yaw_rates[k])
    return JointStates(0.0, speeds[:, k].tolist(), angles[:, k].tolist(), turning, None, yaw_rate)


# -- odometry of many robots -----------------------------------------------------------------------

# The robots of a scene read their joints at the same time, and the same odometry equations apply to
# identical robots.  The results equal the results of ``Odometry.update`` for each robot, except for
# rounding errors.

_MIN_INTERVAL = 1e-4
"""Shortest interval (s) between joint states, because rates over shorter intervals may overflow."""
_MAX_VALUE = 1e9
"""Joint states (SI units) from this limit on are left to the scalar odometry."""


class OdometryBatch:
    """Odometry of several robots with the same wheels, noise and calculator options.

    ``calculator`` is the base calculator of any robot in the batch.  The calculator must use the
    method ``BaseCalculator.odometry`` without changes.  The wheels of the robots must determine the
    whole twist at any steering angles.

    Each array of the batch has one column per robot.  The columns of a robot contain a copy of its
    ``Odometry`` after the last update.
    """

    def __init__(self, calculator: BaseCalculator, odometries: Sequence[Odometry]) -> None:
        self._batch = CalculatorBatch(calculator)
        self._odometries = odometries
        n, wheels = len(odometries), self._batch.wheels
        self._wheels = wheels
        self._times = np.zeros(n)
        self._joints = np.zeros((2, wheels, n))  # positions and steering angles, rad
        self._poses = np.zeros((3, n))
        self._covariances = np.zeros((6, n))
        # Objects in the odometry of each robot from which the array columns were copied.  If the
        # odometry of a robot contains other objects, code outside of the batch has changed the
        # odometry.
        self._copied: list[tuple[JointStates, Pose2, Cov3] | None] = [None] * n

    def update(self, joints: Sequence[JointStates], now: float) -> None:
        """Updates the odometry of each robot with the robot's joint states.

        Robots with unusual joint states are left out.  Joint states are unusual if wheel positions
        are missing, if the joint states contain a yaw rate, if the interval since the last joint
        states is too short or too long, or if a joint state is very large or not finite.
        """
        robots = [k for k, states in enumerate(joints) if self._is_usual(k, states)]
        if not robots:
            return
        table = np.fromiter(
            chain.from_iterable(chain.from_iterable(_values(joints[k]) for k in robots)), float
        ).reshape(len(robots), 4, self._wheels)
        valid = (np.abs(table) < _MAX_VALUE).all(axis=(1, 2))  # also false for NaN
        if not valid.all():
            robots = [k for k, good in zip(robots, valid.tolist(), strict=True) if good]
            table = table[valid]
        if robots:
            positions_and_angles = np.ascontiguousarray(table[:, :2].transpose(1, 2, 0))
            self._integrate(robots, joints, positions_and_angles, now)

    def _is_usual(self, k: int, states: JointStates) -> bool:
        odometry, copied = self._odometries[k], self._copied[k]
        previous = odometry.joints
        if (
            previous is None
            or previous.positions is None
            or states.positions is None
            or states.yaw_rate is not None
            or not len(states.positions) == len(states.angles) == self._wheels
            or not len(states.speeds) == len(states.angle_rates) == self._wheels
            or not _MIN_INTERVAL <= states.time - previous.time <= LONGEST_INTERVAL
        ):
            return False
        if (
            copied is None
            or copied[0] is not previous
            or copied[1] is not odometry.pose
            or copied[2] is not odometry.covariance_at_joints
        ):
            self._times[k] = previous.time
            self._joints[:, :, k] = previous.positions, previous.angles
            self._poses[:, k] = odometry.pose
            self._covariances[:, k] = _upper(odometry.covariance_at_joints)
        return True

    def _integrate(
        self, robots: list[int], joints: Sequence[JointStates], end: Array, now: float
    ) -> None:
        """Integrates the motion of all robots over the interval between two joint states.

        ``end`` contains the positions of the spin joints and the steering angles at the end of the
        interval, in rad.  The shape of ``end`` is (2, wheels, robots).
        """
        n = len(robots)
        start, times = self._joints[:, :, robots], np.array([joints[k].time for k in robots])
        dt = times - self._times[robots]
        speeds, rates = (end - start) / dt
        angles = (start[1] + end[1]) / 2.0
        twists, noise, tests = np.empty((3, n)), np.empty((6, n)), np.empty((self._wheels, n))
        suspects: dict[int, tuple[int, ...]] = {}
        dropped = self._batch.estimate(
            speeds,
            angles,
            twists,
            noise,
            tests,
            rates,
            commanded=lambda i: self._odometries[robots[i]].calculator.commanded_speeds,
            suspects=suspects,
        )
        dx, dy, angle = twists * dt
        turn = _turn(angle)
        poses = _moved(self._poses[:, robots], dx, dy, angle, turn)
        covariances = _full(self._covariances[:, robots])
        grown = propagated(covariances, _full(noise), dx, dy, turn, dt * dt)
        new_covariances = np.array(_upper(grown))
        self._times[robots], self._joints[:, :, robots] = times, end
        self._poses[:, robots], self._covariances[:, robots] = poses, new_covariances
        columns = [array.T.tolist() for array in (twists, noise, tests, poses, new_covariances)]
        for i, (k, twist, q, test, pose, p) in enumerate(zip(robots, *columns, strict=True)):
            estimate = TwistEstimate(
                Twist(*twist), _full(q), 3, tuple(test), dropped.get(i, ()), suspects.get(i, ())
            )
            states, new_pose, covariance = self._copied[k] = joints[k], Pose2(*pose), _full(p)
            self._odometries[k].store(states, now, estimate, new_pose, covariance)


def _values(states: JointStates) -> tuple[Sequence[float], ...]:
    return states.positions or (), states.angles, states.speeds, states.angle_rates


def _moved(poses: Array, dx: Array, dy: Array, angle: Array, turn: Turn) -> Array:
    """Moves an array of robot poses by the motion of a constant twist.

    The result equals ``Pose2.moved`` with the step from ``se2.exp``.
    """
    x, y = turn.s1 * dx - turn.c1 * dy, turn.c1 * dx + turn.s1 * dy
    c, s = np.cos(poses[2]), np.sin(poses[2])
    return np.array([poses[0] + c * x - s * y, poses[1] + s * x + c * y, poses[2] + angle])


def _turn(angle: Array) -> Turn:
    small = np.abs(angle) < 1e-3
    a = np.where(small, 1.0, angle)
    s, half = np.sin(a), np.sin(a / 2.0)
    square, versin = angle * angle, 2.0 * half * half
    return Turn(
        np.cos(angle),
        np.sin(angle),
        np.where(small, 1.0 - square / 6.0 * (1.0 - square / 20.0), s / a),
        np.where(small, angle / 2.0 * (1.0 - square / 12.0), versin / a),
        np.where(small, angle / 6.0, (a - s) / (a * a)),
        np.where(small, 0.5, versin / (a * a)),
    )


def _upper(covariance: Any) -> tuple[Any, ...]:
    (a, b, c), (_, d, e), (_, _, f) = covariance
    return a, b, c, d, e, f


def _full(upper: Any) -> Any:
    a, b, c, d, e, f = upper
    return (a, b, c), (b, d, e), (c, e, f)


# -- odometry of many ticks ------------------------------------------------------------------------

# The joint commands of a driver do not depend on the odometry.  If nobody reads the odometry before
# the end of a run, the joint states of the ticks are stored, and a few array operations estimate
# all twists.

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
