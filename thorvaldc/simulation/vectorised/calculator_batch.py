"""Evaluates a base calculator for arrays of twists or joint states, for replay and learning.

All arrays have the type float64, one row per component, and one column per state of the robot.
Twists have the shape (3, n) with the rows vx, vy and wz of ``base_link`` (m/s, m/s, rad/s).  Joint
values have the shape (wheels, n), in the order of the robot's wheels.  The methods write their
results into arrays that the caller has allocated.  The input arrays are processed in pieces of
columns that fit into the cache of a processor core.  No additional array of the size of the input
is allocated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimator
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.simulation.vectorised import fit_batch

Array = NDArray[np.float64]
_PIECE_SIZE = 8192
"""Number of array columns that are processed at a time."""
_GATE_TOLERANCE = 1e-6
"""Relative difference of a chi-square from its limit within which rounding errors may decide."""
MAX_VALUE = 1e9
"""Twists and joint states (SI units) with an absolute value from this limit on are rejected."""


class CalculatorBatch:
    """Evaluates a base calculator for arrays of twists or joint states.

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
