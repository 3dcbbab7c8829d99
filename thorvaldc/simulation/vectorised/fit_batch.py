"""Fits the twists of many states by weighted least squares, and tests the wheels.

The module ``thorvaldc.runtime.calculators.twist_fit`` derives the equations.  The twists have the
same order of operations as there.  With the same cosines and sines they are equal to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.calculators import twist_fit
from thorvaldc.runtime.calculators.twist_estimator import RANK_TOLERANCE, TwistEstimator
from thorvaldc.runtime.calculators.twist_fit import solve3

Array = NDArray[np.float64]
Value = Array | float


def exact(function: Callable[[float], float], values: Array) -> Array:
    """Returns ``function`` of each value, with the shape of ``values``.

    ``function`` is a function of the module ``math``.  The functions of numpy differ from it in the
    last bit, depending on the processor and on the version of numpy.
    """
    flat = values.ravel().tolist()
    return np.fromiter(map(function, flat), np.float64, len(flat)).reshape(values.shape)


_SINGULAR = 1e-250
"""Determinants of matrices with a smaller absolute value count as 0."""


class MeasurementBatch(NamedTuple):
    """Measurements of one wheel in all robot states, with the fields of ``twist_fit.Measurement``.

    A field is an array with one value per robot state, or a number that applies to all states.
    """

    wheel: twist_fit.WheelConstants
    c: Value
    s: Value
    x: Value
    y: Value
    z_l: Array
    z_t: Value


class WeightedBatch(NamedTuple):
    """Linearised measurements of one wheel in all robot states.

    The fields are the same as in ``twist_fit.WeightedMeasurement``.
    """

    wheel: twist_fit.WheelConstants
    c: Value
    s: Value
    x: Value
    y: Value
    mx: Array
    my: Array
    v_l: Array
    v_t: Array


class FitBatch(NamedTuple):
    """Fitted twists in all robot states, about the centroid of the wheels.

    - ``twist``: arrays of the twist components vx, vy and wz.
    - ``covariance``: upper halves of the covariance matrices of the twists.
    - ``measurements``: linearised measurements of each wheel.
    """

    twist: tuple[Array, Array, Array]
    covariance: tuple[Array, Array, Array, Array, Array, Array]
    measurements: list[WeightedBatch]


def measure(
    estimator: TwistEstimator,
    speeds: Array,
    angles: Array,
    rates: Array | None,
    *,
    as_scalar: bool = False,
) -> list[MeasurementBatch]:
    """Converts arrays of joint states, shape (wheels, n), to wheel measurements.

    - ``speeds``: wheel speeds, rad/s.
    - ``angles``: steering angles, rad.
    - ``rates``: steering rates in rad/s, or ``None`` if all steering rates are 0.
    - ``as_scalar``: whether the cosines and sines have the same bits as in the scalar estimator,
      which takes longer.
    """
    measurements = []
    for wheel in estimator.wheels:
        z_l, z_t = speeds[wheel.number] * wheel.radius, 0.0
        c: Value = wheel.cos
        s: Value = wheel.sin
        x: Value = wheel.x
        y: Value = wheel.y
        if wheel.steered:
            if as_scalar:
                direction = wheel.heading + wheel.sign * angles[wheel.number]
                c, s = exact(math.cos, direction), exact(math.sin, direction)
            else:
                c, s = _cosine_and_sine(wheel, angles[wheel.number])
            if wheel.trail or wheel.lateral:
                x = wheel.x + ((c - wheel.cos) * wheel.trail - (s - wheel.sin) * wheel.lateral)
                y = wheel.y + ((s - wheel.sin) * wheel.trail + (c - wheel.cos) * wheel.lateral)
                if rates is not None:
                    turning = rates[wheel.number] * wheel.sign
                    z_l += turning * wheel.lateral
                    if wheel.trail:
                        z_t = turning * -wheel.trail
        measurements.append(MeasurementBatch(wheel, c, s, x, y, z_l, z_t))
    return measurements


def _cosine_and_sine(wheel: twist_fit.WheelConstants, angles: Array) -> tuple[Array, Array]:
    """Returns the rolling direction of a steered wheel.

    Both numbers are computed from a single tangent, which is five times as fast as a cosine and a
    sine: with t = tan(direction / 2), c = 2 / (1 + t^2) - 1 and s = t (1 + c).
    """
    t = angles * (wheel.sign / 2.0)
    if wheel.heading:
        t += wheel.heading / 2.0
    np.tan(t, out=t)
    q = t * t
    q += 1.0
    np.divide(2.0, q, out=q)
    t *= q
    q -= 1.0
    return q, t


def unweighted_fit(
    estimator: TwistEstimator,
    measurements: Sequence[MeasurementBatch],
    yaw_rates: Array | None,
    n: int,
) -> tuple[tuple[Array, Array, Array], NDArray[np.bool_] | None]:
    """Returns unweighted least-squares twists about the centroid, and a mask of low ranks.

    The mask is ``True`` for robot states in which the measurements do not determine the whole twist
    (rank below 3); their twists here are zero, and the scalar estimator computes them.  The mask is
    ``None`` if the rank is 3 in all robot states, or if ``estimator.inverse`` is used, which
    already contains the rank.
    """
    b1, b2, b3 = np.zeros(n), np.zeros(n), np.zeros(n)
    if estimator.inverse is not None and yaw_rates is None:
        for m in measurements:
            if not m.wheel.flags & twist_fit.USE_ROLL:
                continue
            zx, zy = m.c * m.z_l, m.s * m.z_l
            b1 += zx
            b2 += zy
            zy *= m.x
            zx *= m.y
            zy -= zx
            b3 += zy
        (q11, q12, q13, q22, q23, q33), _ = estimator.inverse
        return _times(q11, q12, q13, q22, q23, q33, b1, b2, b3), None
    a11, a12, a13, a22, a23, a33 = (np.zeros(n) for _ in range(6))
    for wheel, c, s, x, y, z_l, z_t in measurements:
        l3, t3 = s * x - c * y, c * x + s * y
        if wheel.flags & twist_fit.USE_ROLL:
            a11 += c * c
            a12 += c * s
            a13 += c * l3
            a22 += s * s
            a23 += s * l3
            a33 += l3 * l3
            b1 += c * z_l
            b2 += s * z_l
            b3 += l3 * z_l
        if wheel.flags & twist_fit.USE_SIDE:
            a11 += s * s
            a12 -= s * c
            a13 -= s * t3
            a22 += c * c
            a23 += c * t3
            a33 += t3 * t3
            b1 -= s * z_t
            b2 += c * z_t
            b3 += t3 * z_t
    k = estimator.length2
    if yaw_rates is not None:
        a33 += k
        b3 += k * yaw_rates
    det = (
        a11 * (a22 * a33 - a23 * a23)
        - a12 * (a12 * a33 - a13 * a23)
        + a13 * (a12 * a23 - a13 * a22)
    )
    mean = (a11 + a22 + a33 / k) / 3.0
    low = det <= RANK_TOLERANCE * k * mean * mean * mean
    with np.errstate(divide="ignore", invalid="ignore"):  # singular matrices
        equations: list[Any] = [a11, a12, a13, a22, a23, a33, b1, b2, b3]
        twist: Any = solve3(*equations)
    if not low.any():
        return twist, None
    # The solution of a singular matrix may be infinite, of which numpy warns in the next step.
    vx, vy, wz = (np.where(low, 0.0, value) for value in twist)
    return (vx, vy, wz), low


def fit_twists(
    estimator: TwistEstimator,
    measurements: Sequence[MeasurementBatch],
    predicted: tuple[Array, Array, Array],
    yaw_rates: Array | None,
) -> FitBatch:
    """Computes a Gauss-Newton step for arrays of twists, as ``twist_fit.fit_twist`` does."""
    vx, vy, wz = predicted
    ratio2, angle2, floor2, slip2, skid2, gyro2 = estimator.squares
    a11, a12, a13, a22, a23, a33, b1, b2, b3 = (np.zeros_like(vx) for _ in range(9))
    if estimator.inverse is not None and estimator.inverse[1] < 3 and yaw_rates is None:
        a11 += estimator.prior[0]
        a22 += estimator.prior[0]
        a33 += estimator.prior[1]
    if yaw_rates is not None:
        a33 += 1.0 / gyro2
        b3 += (1.0 / gyro2) * yaw_rates
    weighted: list[WeightedBatch] = []
    skidding = [m for m in measurements if m.wheel.skids]
    for wheel, c, s, x, y, z_l, z_t in measurements:
        ux, uy = vx - wz * y, vy + wz * x
        if wheel.trail:
            ux += s * z_t
            uy -= c * z_t
        across = c * uy - s * ux
        a2 = ux * ux
        a2 += uy * uy
        v2 = a2 + z_t * z_t if wheel.trail else a2
        v_l = v2 * ratio2
        v_l += floor2
        v_t = v2 * angle2
        v_t += slip2
        if wheel.steered:
            t2 = across * across
            near = t2 < 0.25 * a2 - twist_fit.STILL
            k = np.sqrt(a2)
            np.copysign(k, c * ux + s * uy, out=k)
            c, s = np.array(c), np.array(s)
            np.divide(ux, k, out=c, where=near)
            np.divide(uy, k, out=s, where=near)
            a2 *= 6.0
            np.divide(t2, a2, out=t2, where=near)
            t2 += 1.0
            t2 *= across
            t2 *= near
            z_t = z_t - t2
        elif wheel.skids:
            v_l = np.zeros_like(vx)
            for m in skidding:
                v_l += (m.c * (vx - wz * m.y) + m.s * (vy + wz * m.x)) ** 2
            v_l /= len(skidding)
            v_l *= skid2
            v_l += floor2
            v_t = v_l
        if wheel.steered:
            mx, my = c * z_l - s * z_t, s * z_l + c * z_t
        else:
            mx, my = c * z_l, s * z_l
        weighted.append(WeightedBatch(wheel, c, s, x, y, mx, my, v_l, v_t))
        w_t = 1.0 / v_t
        k = 1.0 / v_l - w_t if wheel.flags & twist_fit.USE_ROLL else -w_t
        kc = k * c
        w11, w12 = kc * c, kc * s
        w11 += w_t
        w22 = w_t + k * s * s
        tx, ty = w12 * x - w11 * y, w22 * x - w12 * y
        a11 += w11
        a12 += w12
        a13 += tx
        a22 += w22
        a23 += ty
        ty *= x
        tx *= y
        ty -= tx
        a33 += ty
        tx, ty = w11 * mx + w12 * my, w12 * mx + w22 * my
        b1 += tx
        b2 += ty
        b3 += ty * x - tx * y
    inverse, _ = _inverse(a11, a12, a13, a22, a23, a33)
    return FitBatch(_times(*inverse, b1, b2, b3), inverse, weighted)


def chi_squares(fit: FitBatch, result: Array) -> None:
    """Writes the chi-square D of each wheel into ``result`` (wheels, n).

    The documentation of ``twist_fit.chi_squares`` defines the chi-square D of a wheel.
    """
    vx, vy, wz = fit.twist
    p11, p12, p13, p22, p23, p33 = fit.covariance
    for d, (wheel, c, s, x, y, mx, my, v_l, v_t) in zip(result, fit.measurements, strict=True):
        if not wheel.flags & twist_fit.TEST_SIDE:
            d[:] = 0.0
            continue
        u11 = p11 + y * (y * p33 - 2.0 * p13)
        u12 = p12 + x * p13 - y * (p23 + x * p33)
        u22 = p22 + x * (x * p33 + 2.0 * p23)
        rx, ry = mx - vx + wz * y, my - vy - wz * x
        if wheel.flags != twist_fit.ROLL_AND_SIDE:
            r_t = c * ry - s * rx
            s_t = v_t - (s * s * u11 - 2.0 * c * s * u12 + c * c * u22)
            d[:] = 0.0
            np.divide(r_t * r_t, s_t, out=d, where=s_t > twist_fit.UNTESTABLE * v_t)
            continue
        k = v_l - v_t
        kc = k * c
        s11, s12, s22 = v_t + kc * c - u11, kc * s - u12, v_t + k * s * s - u22
        det = s11 * s22 - s12 * s12
        regular = det > twist_fit.UNTESTABLE * v_l * v_t
        if not regular.all():
            # The covariance S of the residual has rank 1 at most.
            # The function ``twist_fit.compare_with_others`` explains covariances of rank 1.
            h_l = c * c * u11 + 2.0 * c * s * u12 + s * s * u22
            scale = (v_l - h_l) / v_l + (v_t - (u11 + u22 - h_l)) / v_t
            r_l, r_t = c * rx + s * ry, c * ry - s * rx
            scale = np.where(scale > twist_fit.UNTESTABLE, scale, np.inf)
            singular = (r_l * r_l / v_l + r_t * r_t / v_t) / scale
            det = np.where(regular, det, 1.0)
        d[:] = ((s22 * rx - 2.0 * s12 * ry) * rx + s11 * ry * ry) / det
        if not regular.all():
            d[:] = np.where(regular, d, singular)


def _inverse(
    a11: Array, a12: Array, a13: Array, a22: Array, a23: Array, a33: Array
) -> tuple[tuple[Array, Array, Array, Array, Array, Array], Array]:
    """Inverts symmetric 3 x 3 matrices by cofactors.

    Returns the upper halves of the inverse matrices, and the determinants.  For a singular matrix,
    the adjugate is returned instead of the inverse.
    """
    p11 = a22 * a33 - a23 * a23
    p12 = a13 * a23 - a12 * a33
    p13 = a12 * a23 - a13 * a22
    det = a11 * p11 + a12 * p12 + a13 * p13
    d = 1.0 / np.where(np.abs(det) < _SINGULAR, 1.0, det)
    p22 = (a11 * a33 - a13 * a13) * d
    p23 = (a12 * a13 - a11 * a23) * d
    p33 = (a11 * a22 - a12 * a12) * d
    p11 *= d
    p12 *= d
    p13 *= d
    return (p11, p12, p13, p22, p23, p33), det


def _times(
    q11: Value,
    q12: Value,
    q13: Value,
    q22: Value,
    q23: Value,
    q33: Value,
    b1: Array,
    b2: Array,
    b3: Array,
) -> tuple[Array, Array, Array]:
    return (
        q11 * b1 + q12 * b2 + q13 * b3,
        q12 * b1 + q22 * b2 + q23 * b3,
        q13 * b1 + q23 * b2 + q33 * b3,
    )
