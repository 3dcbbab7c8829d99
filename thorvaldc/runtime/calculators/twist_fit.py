"""One weighted fit of a twist to what the wheels say, and how well each wheel agrees.

Both run at every tick: plain Python on plain numbers, each operation counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

# A wheel says its speed along (its encoder) and that it has none across (it holds its direction).
# What of this is used, and what is tested against the others, is two things: a wheel left
# out keeps its place, so that its misfit is known; one that skids is used but not tested.
USE_ROLL, USE_SIDE, TEST_ROLL, TEST_SIDE = 1, 2, 4, 8
SIDE = USE_SIDE | TEST_SIDE
BOTH = USE_ROLL | TEST_ROLL | SIDE

Reading = tuple[int, float, float, float, float, float, float, bool, bool]
"""What a wheel says: the bits above, its direction (cos, sin), the place of its contact from the
centre (m), speed of the contact along and across (m/s), whether a motor turns it, whether it
skids."""

Line = tuple[int, float, float, float, float, float, float, float, float]
"""A reading about a predicted twist: bits, direction, place, the velocity of the contact that it
measures (x, y), the variances of that along and across."""

Squares = tuple[float, float, float, float, float, float]

STILL = 2.5e-13
"""A quarter of the square of a speed, (1e-6 m/s)^2, below which rounding decides a direction."""
UNTESTABLE = 1e-6
"""Share of a reading's variance that the others must leave of it to test it."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What is taken of the wheels' errors.

    ``speed_ratio``: of a wheel's speed, relative; ``angle``: of its direction,
    rad; ``speed_floor`` and ``slip_floor``: m/s along and across the wheel at
    rest; ``skid_ratio``: of the speed, for wheels that must scrub in turns;
    ``gyro``: of the yaw rate, rad/s, where one is measured.  ``correlation`` (s): how
    long an error lasts, as those of ground and tyres do; 0: not from one tick to
    the next.  It makes no twist less certain, but poses.
    """

    speed_ratio: float = 0.01
    angle: float = math.radians(0.5)
    speed_floor: float = 0.002
    slip_floor: float = 0.002
    skid_ratio: float = 0.1
    gyro: float = 0.005
    correlation: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = value >= 0.0 if field.name == "correlation" else value > 0.0
            if not (least and math.isfinite(value)):
                raise ValueError(f"the noise {field.name} is {value:g}; it must be positive")

    @property
    def squares(self) -> Squares:
        """The squares of all but the last, in their order; of what can be reckoned with."""
        return (
            _square(self.speed_ratio),
            _square(self.angle),
            _square(self.speed_floor),
            _square(self.slip_floor),
            _square(self.skid_ratio),
            _square(self.gyro),
        )


def _square(noise: float) -> float:
    """Within bounds: their products and quotients are numbers, too."""
    return min(max(noise, 1e-12), 1e12) ** 2


class Row(NamedTuple):
    """A wheel that holds its direction; ``cos``, ``sin``, ``x``, ``y``: with its joint at 0."""

    wheel: int
    heading: float
    sign: float
    cos: float
    sin: float
    x: float
    y: float
    trail: float
    lateral: float
    radius: float
    kind: int
    turns: bool
    skids: bool


class Fit(NamedTuple):
    """A twist about the centre, its covariance's upper half, the lines it rests on."""

    vx: float
    vy: float
    wz: float
    p11: float
    p12: float
    p13: float
    p22: float
    p23: float
    p33: float
    lines: list[Line]


def fit(
    readings: Sequence[Reading],
    vx: float,
    vy: float,
    wz: float,
    noise: Squares,
    prior: tuple[float, float],
    yaw_rate: float | None,
) -> Fit:
    """One Gauss-Newton step from a predicted twist: weighted least squares of all readings.

    A wheel measures the speed of its contact, with an error of ``speed_ratio``
    of it, and where it is steered its direction, with one of ``angle``.  Both
    are taken about the wheel's *predicted* velocity: a stalled encoder does not
    pass for a certain one, and an error of the angle does not shorten the speed.
    ``noise``: the squares of a ``Noise``; ``prior``: information on velocity and yaw
    rate, at rest.
    """
    sqrt = math.sqrt
    ratio2, angle2, floor2, slip2, skid2, gyro2 = noise
    a11, a33 = prior
    a22 = a11
    a12 = a13 = a23 = b1 = b2 = b3 = 0.0
    if yaw_rate is not None:
        w_t = 1.0 / gyro2
        a33 += w_t
        b3 = w_t * yaw_rate
    lines: list[Line] = []
    v_skid = 0.0
    for kind, c, s, x, y, z_l, z_t, turns, skids in readings:
        ux, uy = vx - wz * y, vy + wz * x
        if z_t:
            ux, uy = ux + s * z_t, uy - c * z_t
        across = c * uy - s * ux
        a2 = ux * ux + uy * uy
        v2 = a2 + z_t * z_t
        v_l, v_t = ratio2 * v2 + floor2, angle2 * v2 + slip2
        if turns:
            # About the direction it is predicted to have, where that is near its angle.
            t2 = across * across
            if t2 < 0.25 * a2 - STILL:
                k = sqrt(a2) if c * ux + s * uy > 0.0 else -sqrt(a2)
                c, s = ux / k, uy / k
                # The arc from there to its angle: a asin(across / a).
                z_t -= across * (1.0 + t2 / (6.0 * a2))
        elif skids:
            if v_skid == 0.0:
                v_skid = skid2 * _mean_square_roll(readings, vx, vy, wz) + floor2
            v_l = v_t = v_skid
        mx, my = c * z_l - s * z_t, s * z_l + c * z_t
        lines.append((kind, c, s, x, y, mx, my, v_l, v_t))
        w_t = 1.0 / v_t
        k = 1.0 / v_l - w_t
        if kind != BOTH:
            w_t = w_t if kind & USE_SIDE else 0.0
            k = 1.0 / v_l - w_t if kind & USE_ROLL else -w_t
        # Information on the contact's velocity: w_t 1 + (w_l - w_t) d d^T.
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
    return Fit(
        p11 * b1 + p12 * b2 + p13 * b3,
        p12 * b1 + p22 * b2 + p23 * b3,
        p13 * b1 + p23 * b2 + p33 * b3,
        p11,
        p12,
        p13,
        p22,
        p23,
        p33,
        lines,
    )


def _mean_square_roll(readings: Sequence[Reading], vx: float, vy: float, wz: float) -> float:
    """Friction does not ask how fast a wheel scrubs: all that skid weigh the same."""
    rolls = [
        c * (vx - wz * y) + s * (vy + wz * x) for _, c, s, x, y, _, _, _, skids in readings if skids
    ]
    return sum(v * v for v in rolls) / len(rolls)


def chi_squares(found: Fit) -> list[float]:
    """D of each line: how badly it agrees with the others.

    D = r^T S^-1 r with S = R - H P H^T for what the fit rests on and R + H P H^T
    for what was left out: by how much the misfit of all sinks without the wheel.
    Chi-square of two degrees of freedom, of one for a wheel that has only a
    side; 0 for what no other reading tells anything about.
    """
    vx, vy, wz, p11, p12, p13, p22, p23, p33, lines = found
    result: list[float] = []
    for line in lines:
        kind, c, s, x, y, mx, my, v_l, v_t = line
        if kind == BOTH:
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
        result.append(test(found, line).chi_square)
    return result


class Test(NamedTuple):
    """A line against the others: D of all it says, of its speed along and across alone.

    ``spare``: whether the others still determine the twist without it.
    """

    chi_square: float
    roll: float
    side: float
    spare: bool


def test(found: Fit, line: Line) -> Test:
    """The parts of a line's D, used or not."""
    vx, vy, wz, p11, p12, p13, p22, p23, p33, _ = found
    kind, c, s, x, y, mx, my, v_l, v_t = line
    u11 = p11 + y * (y * p33 - 2.0 * p13)
    u12 = p12 + x * p13 - y * (p23 + x * p33)
    u22 = p22 + x * (x * p33 + 2.0 * p23)
    rx, ry = mx - vx + wz * y, my - vy - wz * x
    r_l, r_t = c * rx + s * ry, c * ry - s * rx
    h_l = c * c * u11 + 2.0 * c * s * u12 + s * s * u22
    h_t = u11 + u22 - h_l
    uses_l, uses_t = bool(kind & USE_ROLL), bool(kind & USE_SIDE)
    s_l = v_l - h_l if uses_l else v_l + h_l
    s_t = v_t - h_t if uses_t else v_t + h_t
    spare_l, spare_t = s_l > UNTESTABLE * v_l, s_t > UNTESTABLE * v_t
    roll = r_l * r_l / s_l if kind & TEST_ROLL and spare_l else 0.0
    side = r_t * r_t / s_t if kind & TEST_SIDE and spare_t else 0.0
    if not (kind & TEST_ROLL and kind & TEST_SIDE and uses_l == uses_t):
        return Test(roll + side, roll, side, spare_l and spare_t)
    s_lt = c * s * (u22 - u11) + (c * c - s * s) * u12
    if uses_l:
        s_lt = -s_lt
    det = s_l * s_t - s_lt * s_lt
    if det > UNTESTABLE * v_l * v_t:
        both = (s_t * r_l * r_l - 2.0 * s_lt * r_l * r_t + s_l * r_t * r_t) / det
        return Test(both, roll, side, True)
    # Of two directions the others know one, and the residual lies in it.
    known = s_l / v_l + s_t / v_t
    both = (r_l * r_l / v_l + r_t * r_t / v_t) / known if known > UNTESTABLE else 0.0
    return Test(both, roll, side, False)


def misfit(found: Fit) -> float:
    """Sum of the squared residuals of all that is used, in units of their variances."""
    vx, vy, wz = found[:3]
    total = 0.0
    for kind, c, s, x, y, mx, my, v_l, v_t in found.lines:
        rx, ry = mx - vx + wz * y, my - vy - wz * x
        if kind & USE_ROLL:
            total += (c * rx + s * ry) ** 2 / v_l
        if kind & USE_SIDE:
            total += (c * ry - s * rx) ** 2 / v_t
    return total


class Sums(NamedTuple):
    """Normal equations of a least squares of all readings with equal weights."""

    a11: float
    a12: float
    a13: float
    a22: float
    a23: float
    a33: float
    b1: float
    b2: float
    b3: float


def equal_weights(readings: Sequence[Reading]) -> Sums:
    """The sums of unweighted least squares, rows L and T of what each reading uses."""
    a11 = a12 = a13 = a22 = a23 = a33 = b1 = b2 = b3 = 0.0
    for kind, c, s, x, y, z_l, z_t, _, _ in readings:
        if kind & USE_ROLL:
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
        if kind & USE_SIDE:
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
    return Sums(a11, a12, a13, a22, a23, a33, b1, b2, b3)
