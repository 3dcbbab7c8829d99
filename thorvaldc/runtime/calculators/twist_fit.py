"""Weighted least-squares fit of a twist to the wheel measurements, and a test of each wheel.

Velocity u of the contact point of a wheel at (x, y), if the robot moves with the twist xi = (vx,
vy, wz):

    u = H xi,   H = [1  0  -y]
                    [0  1   x]

Two measurements of the velocity u by a wheel with the rolling direction d = (c, s) and the normal n
= (-s, c):

    L xi = z_L,   L = d' H = [ c,  s,  s x - c y]   rolling: the encoder's speed
    T xi = z_T,   T = n' H = [-s,  c,  c x + s y]   no side slip: 0

The two measurements of a wheel have independent errors, which grow with the speed a = |u| of the
contact point.  Variances of the measurement errors:

    sigma_L^2 = (rolling a)^2 + speed_floor^2
    sigma_T^2 = (direction a)^2 + slip_floor^2

The relative error ``rolling`` of a speed and the error ``direction`` of a direction include lasting
errors (see ``Noise``).

The speed a of the contact point is predicted by a first estimate of the twist.  If the measured
speed were used, a stalled encoder would report 0 m/s with a very small variance and dominate the
fit.

Information matrix W of one wheel, normal equations, and solution, with the weights w = 1 / sigma^2:

    W = w_L d d' + w_T n n' = w_T 1 + (w_L - w_T) d d'
    M = sum H' W H + prior,   b = sum H' W m,   m = z_L d + z_T n
    xi = M^-1 b,   covariance P = M^-1

Positions of wheels are relative to the centroid of the wheels, which keeps the matrix M well
conditioned.  The fit runs in every tick of the driver.  For speed, the code uses plain Python
numbers and computes each component of a matrix separately.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Final, NamedTuple

from thorvaldc.model.sums import float_sum

# Bit flags of a wheel measurement.  With USE_ROLL and USE_SIDE, the fit uses the rolling speed (row
# L) and the side slip (row T).  With TEST_ROLL and TEST_SIDE, the rolling speed and the side slip
# are tested against the other wheels.  The fit does not use a rejected wheel, but the wheel is
# still tested to determine its chi-square.  The fit uses a skidding wheel without a test.
USE_ROLL: Final = 1
USE_SIDE: Final = 2
TEST_ROLL: Final = 4
TEST_SIDE: Final = 8
SIDE_ONLY: Final = USE_SIDE | TEST_SIDE
ROLL_AND_SIDE: Final = USE_ROLL | TEST_ROLL | SIDE_ONLY

Measurement = tuple[int, float, float, float, float, float, float, bool, bool]
"""(flags, c, s, x, y, z_L, z_T, steered, skids).

- ``c``, ``s``: rolling direction of the wheel.
- ``x``, ``y``: position of the contact, relative to the centroid (m).
- ``z_L``, ``z_T``: measured speed of the contact along and across the wheel (m/s).
- ``steered``: ``True`` if a motor steers the wheel.
- ``skids``: ``True`` if the wheel skids in turns.
"""

WeightedMeasurement = tuple[int, float, float, float, float, float, float, float, float]
"""(flags, c, s, x, y, m_x, m_y, sigma_L^2, sigma_T^2).

A measurement that is linearised about a predicted twist.  (m_x, m_y) is the measured velocity of
the contact (m/s). sigma_L^2 and sigma_T^2 are the variances along and across the wheel (m^2/s^2).
"""

NoiseSquares = tuple[float, float, float, float, float, float]

STILL: Final = 2.5e-13
"""Below this squared speed, (0.5e-6 m/s)^2, rounding errors determine the direction of motion."""
UNTESTABLE: Final = 1e-6
"""A measurement is tested only if its residual keeps at least this share of its variance."""


MAY_BE_ZERO: Final = ("correlation", "radius_error", "scale_error", "steering_offset_error")
"""Names of the fields of ``Noise`` that may be 0."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of the wheels' measurement errors.

    - ``speed_ratio``: standard deviation of the wheel speed, relative to the speed.  The standard
      deviation includes lasting errors.
    - ``angle``: standard deviation of the wheel's direction, rad.  The standard deviation includes
      lasting errors.
    - ``speed_floor``: standard deviation of the speed along a wheel at rest, m/s.
    - ``slip_floor``: standard deviation of the speed across a wheel at rest, m/s.
    - ``skid_ratio``: standard deviation of the speed of wheels that skid in turns, relative to the
      speed.
    - ``gyro``: standard deviation of the measured yaw rate, rad/s.
    - ``correlation``: time constant of the errors, s.  If ``correlation`` is 0, the measurement
      errors of two ticks are independent.  Measurement errors from ground and tyres last longer
      than a tick: 0.3 to 1.3 s on simulated ground with bumps of 2 cm, and as long as a turn for
      the side slip in a turn.  The time constant affects the covariances of poses, but not the
      covariances of twists.
    - ``radius_error``: standard deviation of the wheel radius, relative to the radius.  The radius
      errors of two wheels are independent, and last for the whole drive.  ``None`` stands for
      ``speed_ratio``: the whole error of the wheel speed may last.
    - ``scale_error``: standard deviation of an error that all radii have in common, relative to the
      radii, in addition to ``radius_error``.
    - ``steering_offset_error``: standard deviation of the zero of a steering angle, or of the
      direction of a fixed wheel, rad.  The errors of two wheels are independent, and last for the
      whole drive.  ``None`` stands for ``angle``.
    """

    speed_ratio: float = 0.01
    angle: float = math.radians(0.5)
    speed_floor: float = 0.002
    slip_floor: float = 0.002
    skid_ratio: float = 0.1
    gyro: float = 0.005
    correlation: float = 2.0
    radius_error: float | None = None
    scale_error: float = 0.0
    steering_offset_error: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            in_range = value >= 0.0 if field.name in MAY_BE_ZERO else value > 0.0
            if not (in_range and math.isfinite(value)):
                raise ValueError(f"the noise {field.name} is {value:g}; it must be positive")

    @property
    def lasting_errors(self) -> tuple[float, float, float]:
        """Standard deviations of a relative radius, of all radii, and of a steering zero (rad)."""
        radius, offset = self.radius_error, self.steering_offset_error
        return (
            self.speed_ratio if radius is None else radius,
            self.scale_error,
            self.angle if offset is None else offset,
        )

    @property
    def rolling(self) -> float:
        """Standard deviation of the wheel speed, relative to the speed, with lasting errors."""
        return max(self.speed_ratio, self.lasting_errors[0], self.scale_error)

    @property
    def direction(self) -> float:
        """Standard deviation (rad) of the wheel's direction, with lasting errors."""
        return max(self.angle, self.lasting_errors[2])

    @property
    def squares(self) -> NoiseSquares:
        """Variances of one measurement.

        The order is: rolling speed (relative), direction (rad^2), speed floor, slip floor, skid
        ratio, and gyro.
        """
        return (
            _bounded_square(self.rolling),
            _bounded_square(self.direction),
            _bounded_square(self.speed_floor),
            _bounded_square(self.slip_floor),
            _bounded_square(self.skid_ratio),
            _bounded_square(self.gyro),
        )


def _bounded_square(noise: float) -> float:
    """Returns the square of ``noise``, which is first limited to 1e-12 to 1e12.

    The limits prevent overflow and underflow in products and quotients of the squares.
    """
    return min(max(noise, 1e-12), 1e12) ** 2


class WheelConstants(NamedTuple):
    """Constants of a wheel that does not swivel.

    - ``number``: index of the wheel in the robot.
    - ``cos``, ``sin``: rolling direction of the wheel at the steering angle 0.
    - ``x``, ``y``: position of the contact at the steering angle 0, relative to the centroid (m).
    - ``radius``: wheel radius (m). 0 for a wheel without encoder.
    - ``flags``: bit flags that select which measurements of the wheel are used and tested.
    - ``steered``: ``True`` if a motor steers the wheel.
    - ``skids``: ``True`` if the wheel skids in turns.
    """

    number: int
    heading: float
    sign: float
    cos: float
    sin: float
    x: float
    y: float
    trail: float
    lateral: float
    radius: float
    flags: int
    steered: bool
    skids: bool


class Fit(NamedTuple):
    """A fitted twist about the centroid, with its covariance and the measurements of all wheels.

    ``p11`` to ``p33`` are the upper half of the covariance matrix P.
    """

    vx: float
    vy: float
    wz: float
    p11: float
    p12: float
    p13: float
    p22: float
    p23: float
    p33: float
    measurements: list[WeightedMeasurement]


def fit_twist(
    measurements: Sequence[Measurement],
    vx: float,
    vy: float,
    wz: float,
    noise: NoiseSquares,
    prior: tuple[float, float],
    yaw_rate: float | None,
) -> Fit:
    """Computes a Gauss-Newton step of the weighted least-squares fit, from a predicted twist.

    - ``vx``, ``vy``, ``wz``: predicted twist about the centroid.
    - ``noise``: variances from ``Noise.squares``.
    - ``prior``: prior information (inverse variances) that the velocity and the yaw rate are 0.
    - ``yaw_rate``: yaw rate (rad/s) that a gyro measures, or ``None`` without a gyro.

    The measured direction of a steered wheel has an error.  With the measured direction in the fit,
    the direction error would reduce the measured speed by the cosine of the error.  The fit
    therefore uses the predicted direction u / a of a steered wheel, where u is the predicted
    velocity of its contact point and a = |u|.  The measured side slip relative to the predicted
    direction is the arc length z_T = -a asin(n . u / a), where n is the normal of the measured
    direction.
    """
    ratio2, angle2, floor2, slip2, skid2, gyro2 = noise
    a11, a33 = prior
    a22 = a11
    a12 = a13 = a23 = b1 = b2 = b3 = 0.0
    if yaw_rate is not None:
        w_t = 1.0 / gyro2
        a33 += w_t
        b3 = w_t * yaw_rate
    weighted: list[WeightedMeasurement] = []
    skid_variance = 0.0
    for flags, c, s, x, y, z_l, z_t, steered, skids in measurements:
        ux, uy = vx - wz * y, vy + wz * x
        if z_t:
            ux, uy = ux + s * z_t, uy - c * z_t
            a2 = ux * ux + uy * uy
            v2 = a2 + z_t * z_t
        else:
            v2 = a2 = ux * ux + uy * uy
        v_l, v_t = ratio2 * v2 + floor2, angle2 * v2 + slip2
        if steered:
            across = c * uy - s * ux
            t2 = across * across
            # The predicted direction of a steered wheel is used only within 30 deg of the measured
            # direction.  A larger difference between both directions means that the wheel is
            # faulty.
            if t2 < 0.25 * a2 - STILL:
                k = math.sqrt(a2) if c * ux + s * uy > 0.0 else -math.sqrt(a2)
                c, s = ux / k, uy / k
                # Taylor series of a asin(across / a) to third order.
                z_t -= across * (1.0 + t2 / (6.0 * a2))
        elif skids:
            if skid_variance == 0.0:
                skid_variance = skid2 * _mean_square_roll(measurements, vx, vy, wz) + floor2
            v_l = v_t = skid_variance
        mx, my = c * z_l - s * z_t, s * z_l + c * z_t
        weighted.append((flags, c, s, x, y, mx, my, v_l, v_t))
        w_t = 1.0 / v_t
        k = 1.0 / v_l - w_t
        if flags != ROLL_AND_SIDE:
            w_t = w_t if flags & USE_SIDE else 0.0
            k = 1.0 / v_l - w_t if flags & USE_ROLL else -w_t
        # Computes the information matrix W = w_t 1 + k d d' of the wheel, and the products H' W and
        # H' W H.
        kc = k * c
        w11, w12, w22 = w_t + kc * c, kc * s, w_t + k * s * s
        tx, ty = w12 * x - w11 * y, w22 * x - w12 * y
        a11 += w11
        a12 += w12
        a13 += tx
        a22 += w22
        a23 += ty
        a33 += ty * x - tx * y
        tx, ty = w11 * mx + w12 * my, w12 * mx + w22 * my
        b1 += tx
        b2 += ty
        b3 += ty * x - tx * y
    p11 = a22 * a33 - a23 * a23
    p12 = a13 * a23 - a12 * a33
    p13 = a12 * a23 - a13 * a22
    d = 1.0 / (a11 * p11 + a12 * p12 + a13 * p13)
    p11, p12, p13 = p11 * d, p12 * d, p13 * d
    p22 = (a11 * a33 - a13 * a13) * d
    p23 = (a12 * a13 - a11 * a23) * d
    p33 = (a11 * a22 - a12 * a12) * d
    vx = p11 * b1 + p12 * b2 + p13 * b3
    vy = p12 * b1 + p22 * b2 + p23 * b3
    wz = p13 * b1 + p23 * b2 + p33 * b3
    return Fit(vx, vy, wz, p11, p12, p13, p22, p23, p33, weighted)


def add_rolling_speed(fit: Fit, wheel: int, speed: float, variance: float) -> Fit:
    """Returns ``fit`` with one more measurement of a wheel's rolling speed (m/s).

    A measurement z = L xi + e with the variance r changes a fit with the covariance P by the gain k
    = P L' / (L P L' + r):

        xi + k (z - L xi),   P - k L P
    """
    vx, vy, wz, p11, p12, p13, p22, p23, p33, measurements = fit
    _, c, s, x, y = measurements[wheel][:5]
    turn = s * x - c * y
    g1 = p11 * c + p12 * s + p13 * turn
    g2 = p12 * c + p22 * s + p23 * turn
    g3 = p13 * c + p23 * s + p33 * turn
    scale = 1.0 / (c * g1 + s * g2 + turn * g3 + variance)
    gain = scale * (speed - c * vx - s * vy - turn * wz)
    return Fit(
        vx + g1 * gain,
        vy + g2 * gain,
        wz + g3 * gain,
        p11 - scale * g1 * g1,
        p12 - scale * g1 * g2,
        p13 - scale * g1 * g3,
        p22 - scale * g2 * g2,
        p23 - scale * g2 * g3,
        p33 - scale * g3 * g3,
        measurements,
    )


def rolling_speed(fit: Fit, wheel: int) -> float:
    """Returns the fitted rolling speed (m/s) of a wheel's contact."""
    _, c, s, x, y = fit.measurements[wheel][:5]
    return c * (fit.vx - y * fit.wz) + s * (fit.vy + x * fit.wz)


def rolling_leverage(fit: Fit, wheel: int) -> float:
    """Returns the influence L P L' / sigma_L^2 of a measured rolling speed on its own estimate.

    The influence is 1 if no other measurement confirms the speed, and 0 if the other measurements
    determine it.
    """
    _, _, _, p11, p12, p13, p22, p23, p33, measurements = fit
    _, c, s, x, y, _, _, v_l, _ = measurements[wheel]
    turn = s * x - c * y
    g1 = p11 * c + p12 * s + p13 * turn
    g2 = p12 * c + p22 * s + p23 * turn
    g3 = p13 * c + p23 * s + p33 * turn
    return (c * g1 + s * g2 + turn * g3) / v_l


def _mean_square_roll(
    measurements: Sequence[Measurement], vx: float, vy: float, wz: float
) -> float:
    """Returns the mean square rolling speed (m^2/s^2) of the skidding wheels.

    All skidding wheels have the same measurement variance, because Coulomb friction does not depend
    on the sliding speed.
    """
    rolls = [
        c * (vx - wz * y) + s * (vy + wz * x)
        for _, c, s, x, y, _, _, _, skids in measurements
        if skids
    ]
    return float_sum(v * v for v in rolls) / len(rolls)


def chi_squares(fit: Fit) -> list[float]:
    """Returns the chi-square D of each wheel: a measure of disagreement with other wheels.

    The residual r = m - H xi of a wheel is the difference between its measured velocity m and its
    fitted velocity H xi.  If the fit uses the wheel, the residual has the covariance S = R - H P
    H', where R is the covariance of the measurement.  The covariance of the residual is smaller
    than R, because the fit follows the errors of all wheels that it uses.  If the fit does not use
    the wheel, the residual has the covariance S = R + H P H'.  Chi-square statistic:

        D = r' S^-1 r

    D has a chi-square distribution with 2 degrees of freedom, or with 1 degree of freedom for a
    wheel without encoder.  If the fit uses the wheel, D is also the decrease of the total misfit
    when this wheel is left out.  The chi-square D is 0 if the other wheels give no redundant
    measurement for this wheel.
    """
    vx, vy, wz, p11, p12, p13, p22, p23, p33, measurements = fit
    result: list[float] = []
    for measurement in measurements:
        flags, c, s, x, y, mx, my, v_l, v_t = measurement
        if flags == ROLL_AND_SIDE:
            # Covariance of the wheel's measurement: R = v_t 1 + (v_l - v_t) d d'.
            k = v_l - v_t
            kc = k * c
            s11 = v_t + kc * c - p11 - y * (y * p33 - 2.0 * p13)
            s12 = kc * s - p12 - x * p13 + y * (p23 + x * p33)
            s22 = v_t + k * s * s - p22 - x * (x * p33 + 2.0 * p23)
            det = s11 * s22 - s12 * s12
            if det > UNTESTABLE * v_l * v_t:
                rx, ry = mx - vx + wz * y, my - vy - wz * x
                result.append(((s22 * rx - 2.0 * s12 * ry) * rx + s11 * ry * ry) / det)
                continue
        result.append(compare_with_others(fit, measurement).chi_square)
    return result


class Comparison(NamedTuple):
    """Disagreement of one wheel with the other wheels.

    - ``chi_square``: chi-square D of both measurements of the wheel.
    - ``roll``: chi-square D of the speed along the wheel alone.
    - ``side``: chi-square D of the speed across the wheel alone.
    - ``redundant``: ``True`` if the other wheels determine the twist without this wheel.
    """

    chi_square: float
    roll: float
    side: float
    redundant: bool


def compare_with_others(fit: Fit, measurement: WeightedMeasurement) -> Comparison:
    """Computes the chi-square D of a wheel, and of its two measurements separately.

    The documentation of ``chi_squares`` defines D. The computation uses the wheel's frame (along,
    across), in which the covariance R of the measurement is diagonal.
    """
    vx, vy, wz, p11, p12, p13, p22, p23, p33, _ = fit
    flags, c, s, x, y, mx, my, v_l, v_t = measurement
    # The matrix H P H' in base_link, and its diagonal elements in the wheel's frame.
    u11 = p11 + y * (y * p33 - 2.0 * p13)
    u12 = p12 + x * p13 - y * (p23 + x * p33)
    u22 = p22 + x * (x * p33 + 2.0 * p23)
    rx, ry = mx - vx + wz * y, my - vy - wz * x
    r_l, r_t = c * rx + s * ry, c * ry - s * rx
    h_l = c * c * u11 + 2.0 * c * s * u12 + s * s * u22
    h_t = u11 + u22 - h_l
    uses_l, uses_t = bool(flags & USE_ROLL), bool(flags & USE_SIDE)
    s_l = v_l - h_l if uses_l else v_l + h_l
    s_t = v_t - h_t if uses_t else v_t + h_t
    testable_l, testable_t = s_l > UNTESTABLE * v_l, s_t > UNTESTABLE * v_t
    roll = r_l * r_l / s_l if flags & TEST_ROLL and testable_l else 0.0
    side = r_t * r_t / s_t if flags & TEST_SIDE and testable_t else 0.0
    if not (flags & TEST_ROLL and flags & TEST_SIDE and uses_l == uses_t):
        return Comparison(roll + side, roll, side, testable_l and testable_t)
    s_lt = c * s * (u22 - u11) + (c * c - s * s) * u12
    if uses_l:
        s_lt = -s_lt
    det = s_l * s_t - s_lt * s_lt
    if det > UNTESTABLE * v_l * v_t:
        both = (s_t * r_l * r_l - 2.0 * s_lt * r_l * r_t + s_l * r_t * r_t) / det
        return Comparison(both, roll, side, True)
    # The covariance S has rank 1, because the other wheels determine only one component of the
    # wheel's velocity u.  The residual r lies in the direction of this component.
    scale = s_l / v_l + s_t / v_t
    both = (r_l * r_l / v_l + r_t * r_t / v_t) / scale if scale > UNTESTABLE else 0.0
    return Comparison(both, roll, side, False)


def misfit(fit: Fit) -> float:
    """Returns the sum of squared residuals over variances of all used measurements."""
    vx, vy, wz = fit[:3]
    total = 0.0
    for flags, c, s, x, y, mx, my, v_l, v_t in fit.measurements:
        rx, ry = mx - vx + wz * y, my - vy - wz * x
        if flags & USE_ROLL:
            total += (c * rx + s * ry) ** 2 / v_l
        if flags & USE_SIDE:
            total += (c * ry - s * rx) ** 2 / v_t
    return total


class NormalEquations(NamedTuple):
    """Normal equations A xi = b with a symmetric matrix A, stored as the upper half of A and b."""

    a11: float
    a12: float
    a13: float
    a22: float
    a23: float
    a33: float
    b1: float
    b2: float
    b3: float


def unweighted_normal_equations(measurements: Sequence[Measurement]) -> NormalEquations:
    """Returns the normal equations of a fit in which all used measurements have equal weights.

    The matrix of the normal equations is the sum of all L'L and T'T. The right-hand side is the sum
    of all L'z_L and T'z_T.
    """
    a11 = a12 = a13 = a22 = a23 = a33 = b1 = b2 = b3 = 0.0
    for flags, c, s, x, y, z_l, z_t, _, _ in measurements:
        if flags & USE_ROLL:
            l3 = s * x - c * y
            a11 += c * c
            a12 += c * s
            a13 += c * l3
            a22 += s * s
            a23 += s * l3
            a33 += l3 * l3
            b1 += c * z_l
            b2 += s * z_l
            b3 += l3 * z_l
        if flags & USE_SIDE:
            t3 = c * x + s * y
            a11 += s * s
            a12 -= s * c
            a13 -= s * t3
            a22 += c * c
            a23 += c * t3
            a33 += t3 * t3
            b1 -= s * z_t
            b2 += c * z_t
            b3 += t3 * z_t
    return NormalEquations(a11, a12, a13, a22, a23, a33, b1, b2, b3)


# -- linear algebra in plain Python, for every control cycle ------------------------------------


def solve3(
    a11: float,
    a12: float,
    a13: float,
    a22: float,
    a23: float,
    a33: float,
    b1: float,
    b2: float,
    b3: float,
) -> tuple[float, float, float]:
    """Solves A x = b by cofactors, for a symmetric positive definite 3 x 3 matrix A."""
    c11 = a22 * a33 - a23 * a23
    c12 = a13 * a23 - a12 * a33
    c13 = a12 * a23 - a13 * a22
    c22 = a11 * a33 - a13 * a13
    c23 = a12 * a13 - a11 * a23
    c33 = a11 * a22 - a12 * a12
    inverse = 1.0 / (a11 * c11 + a12 * c12 + a13 * c13)
    return (
        (c11 * b1 + c12 * b2 + c13 * b3) * inverse,
        (c12 * b1 + c22 * b2 + c23 * b3) * inverse,
        (c13 * b1 + c23 * b2 + c33 * b3) * inverse,
    )


def least_squares3(
    rows: Iterable[tuple[float, float, float, float]], weight: float, angular_weight: float
) -> tuple[float, float, float]:
    """Returns the vector d that minimises sum (l d - v)^2 + weight (d1^2 + d2^2) +
    angular_weight d3^2.

    ``rows``: the rows (l1, l2, l3, v).
    """
    a11 = a22 = weight
    a33 = angular_weight
    a12 = a13 = a23 = b1 = b2 = b3 = 0.0
    for l1, l2, l3, value in rows:
        a11 += l1 * l1
        a12 += l1 * l2
        a13 += l1 * l3
        a22 += l2 * l2
        a23 += l2 * l3
        a33 += l3 * l3
        b1 += l1 * value
        b2 += l2 * value
        b3 += l3 * value
    return solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)
