"""The calculators' mathematics over arrays of states, for replay, learning and sweeps.

Arrays are float64 with a row per component and a column per state: twists (3, n) as
vx, vy, wz of ``base_link`` (m/s, m/s, rad/s), joints (wheels, n) in the order of the
robot's wheels.  Results are written into the caller's arrays, piece by piece, each
small enough for a core's cache: nothing of the size of the input is allocated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCalculator
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimator
from thorvaldc.runtime.errors import NotFiniteError
from thorvaldc.simulation.vectorised import fit_batch as batch_fit
from thorvaldc.simulation.vectorised.inverse_batch import Inverse

Array = NDArray[np.float64]
_PIECE = 8192
BEYOND = 1e9
"""Joints and twists (SI) that nobody can have meant."""


class CalculatorBatch:
    """A calculator over arrays: equal to the calculator itself, one state at a time, to 1e-12."""

    def __init__(self, calculator: BaseCalculator) -> None:
        self.calculator = calculator
        self.wheels = len(calculator.geometry.wheels)
        self._inverse: Inverse | None = None

    def inverse(self, twists: Array, speeds: Array, angles: Array) -> None:
        """Wheel speeds (rad/s) and steering angles (rad) for ``twists``.

        Each twist for itself, as the calculator's command after a reset, without joint
        states: the choice of angles is that of joints at 0.  Raises ``ValueError`` for
        arrays of other shapes and for wheels with their contact ahead of or behind
        their axis, ``NotFiniteError`` for twists that are not finite or beyond 1e9; nothing
        is written then.
        """
        n = self._size(twists)
        for array in (speeds, angles):
            _check(array, (self.wheels, n))
        _check_finite(twists, "twists")
        if self._inverse is None:
            self._inverse = Inverse(self.calculator)
        for piece in _pieces(n):
            self._inverse.solve(twists[:, piece], speeds[:, piece], angles[:, piece])

    def least_squares(
        self, speeds: Array, angles: Array, twists: Array, rates: Array | None = None
    ) -> None:
        """Twists that agree best with the joints, all weighing alike.

        ``speeds`` (rad/s) and ``angles`` (rad) of wheels and ``rates`` (rad/s) of their
        steering, which only count for a contact beside its axis.  As
        ``TwistEstimator.least_squares``.  Raises as ``inverse``.
        """
        n = self._check_joints(speeds, angles, twists, rates)
        estimator = self.calculator.estimator
        for piece in _pieces(n):
            some = _piece(speeds, angles, rates, piece)
            readings = batch_fit.read(estimator, *some)
            twist, low = batch_fit.first(estimator, readings, None, piece.stop - piece.start)
            self._put(twist, twists[:, piece])
            for k in _indices(low):
                twists[:, piece.start + k] = estimator.least_squares(_state(*some, None, k))

    def weighted(
        self,
        speeds: Array,
        angles: Array,
        twists: Array,
        covariances: Array | None = None,
        chi_squares: Array | None = None,
        rates: Array | None = None,
        yaw_rates: Array | None = None,
    ) -> None:
        """Weighted least squares, its covariances and how badly each wheel agrees.

        ``covariances`` (6, n): xx, xy, xw, yy, yw, ww of the twist in SI;
        ``chi_squares`` (wheels, n); ``yaw_rates`` (n): of a gyro, rad/s.  As
        ``TwistEstimator.estimate`` that leaves no wheel out.  Raises as ``inverse``.
        """
        self._estimate(
            speeds, angles, twists, covariances, chi_squares, rates, yaw_rates, reject=False
        )

    def estimate(
        self,
        speeds: Array,
        angles: Array,
        twists: Array,
        covariances: Array | None = None,
        chi_squares: Array | None = None,
        rates: Array | None = None,
        yaw_rates: Array | None = None,
    ) -> dict[int, tuple[int, ...]]:
        """As ``TwistEstimator.estimate``: without the wheels that are wrong.

        Arrays as those of ``weighted``.  Returns the wheels left out, by state.  The few
        states in which a wheel disagrees are done one by one.  Raises as ``inverse``.
        """
        return self._estimate(
            speeds, angles, twists, covariances, chi_squares, rates, yaw_rates, reject=True
        )

    def _estimate(
        self,
        speeds: Array,
        angles: Array,
        twists: Array,
        covariances: Array | None,
        chi_squares: Array | None,
        rates: Array | None,
        yaw_rates: Array | None,
        *,
        reject: bool,
    ) -> dict[int, tuple[int, ...]]:
        n = self._check_joints(speeds, angles, twists, rates)
        if covariances is not None:
            _check(covariances, (6, n))
        if chi_squares is not None:
            _check(chi_squares, (self.wheels, n))
        if yaw_rates is not None:
            _check(yaw_rates, (n,))
            _check_finite(yaw_rates, "yaw rates")
        estimator = self.calculator.estimator
        alone = estimator if reject else self._tolerant()
        gates = np.array(estimator.gates)[:, np.newaxis]
        dropped: dict[int, tuple[int, ...]] = {}
        tests = np.empty((len(estimator.rows), min(n, _PIECE)))
        for piece in _pieces(n):
            some = _piece(speeds, angles, rates, piece)
            gyro = None if yaw_rates is None else yaw_rates[piece]
            readings = batch_fit.read(estimator, *some)
            size = piece.stop - piece.start
            twist, one_by_one = batch_fit.first(estimator, readings, gyro, size)
            for _ in range(1 + estimator.options.polish):
                found = batch_fit.fit(estimator, readings, twist, gyro)
                twist = found.twist
            self._put(twist, twists[:, piece])
            if covariances is not None:
                self._put_covariance(found.covariance, covariances[:, piece])
            if chi_squares is not None or reject:
                batch_fit.chi_squares(found, tests[:, :size])
            if chi_squares is not None:
                chi_squares[:, piece] = 0.0
                chi_squares[[row.wheel for row in estimator.rows], piece] = tests[:, :size]
            if reject and estimator.options.faulty:
                beyond: NDArray[np.bool_] = np.any(tests[:, :size] > gates, axis=0)
                one_by_one = beyond if one_by_one is None else beyond | one_by_one
            for k in _indices(one_by_one):
                told = alone.estimate(_state(*some, gyro, k))
                at = piece.start + k
                twists[:, at] = told.twist
                if covariances is not None:
                    (a, b, c), (_, d, e), (_, _, f) = told.covariance
                    covariances[:, at] = a, b, c, d, e, f
                if chi_squares is not None:
                    chi_squares[:, at] = told.chi_squares
                if told.dropped:
                    dropped[at] = told.dropped
        return dropped

    def _tolerant(self) -> TwistEstimator:
        estimator = self.calculator.estimator
        options = replace(estimator.options, faulty=0)
        return TwistEstimator(self.calculator.geometry, estimator.noise, options)

    def _put(self, twist: tuple[Array, Array, Array], out: Array) -> None:
        """From the centre to ``base_link``."""
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
        for array, what in ((speeds, "speeds"), (angles, "angles"), (rates, "rates")):
            if array is not None:
                _check(array, (self.wheels, n))
                _check_finite(array, what)
        return n

    def _size(self, twists: Array) -> int:
        n = twists.shape[-1] if twists.ndim else 0
        _check(twists, (3, n))
        return n


def _pieces(n: int) -> Iterator[slice]:
    for start in range(0, n, _PIECE):
        yield slice(start, min(start + _PIECE, n))


def _check(array: Array, shape: tuple[int, ...]) -> None:
    if array.shape != shape or array.dtype != np.float64:
        raise ValueError(f"an array of {array.dtype} {array.shape}; expected float64 {shape}")


def _check_finite(array: Array, what: str) -> None:
    if not array.size or max(float(array.max()), -float(array.min())) < BEYOND:
        return
    if not np.isfinite(array).all():
        raise NotFiniteError(f"the {what} are not all finite")
    raise NotFiniteError(f"the {what} are not all below {BEYOND:g}")


def _piece(
    speeds: Array, angles: Array, rates: Array | None, piece: slice
) -> tuple[Array, Array, Array | None]:
    return speeds[:, piece], angles[:, piece], None if rates is None else rates[:, piece]


def _indices(mask: NDArray[np.bool_] | None) -> list[int]:
    return [] if mask is None else [int(k) for k in np.flatnonzero(mask)]


def _state(
    speeds: Array, angles: Array, rates: Array | None, yaw_rates: Array | None, k: int
) -> JointStates:
    """One state as the scalar path takes it."""
    turning = [0.0] * len(speeds) if rates is None else rates[:, k].tolist()
    yaw_rate = None if yaw_rates is None else float(yaw_rates[k])
    return JointStates(0.0, speeds[:, k].tolist(), angles[:, k].tolist(), turning, None, yaw_rate)
