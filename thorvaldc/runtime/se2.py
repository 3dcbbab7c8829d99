"""Planar motion: twists, poses and their exact integration on SE(2).

A twist is given in ``base_link``; a pose is that of ``base_link`` in the
odometry frame.  Covariances are in the order x, y, yaw (or vx, vy, wz); a
pose's is that of a small motion in ``base_link`` (a right perturbation), so
that it does not depend on where the robot is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

Row3 = tuple[float, float, float]
Cov3 = tuple[Row3, Row3, Row3]

ZERO_COV: Cov3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Twist(NamedTuple):
    """Velocity of ``base_link`` in itself: m/s forward, m/s to the left, rad/s."""

    vx: float
    vy: float
    wz: float

    def scaled(self, factor: float) -> Twist:
        return Twist(self.vx * factor, self.vy * factor, self.wz * factor)

    @property
    def finite(self) -> bool:
        return math.isfinite(self.vx) and math.isfinite(self.vy) and math.isfinite(self.wz)

    @property
    def speed(self) -> float:
        """Speed of the origin, m/s."""
        return math.hypot(self.vx, self.vy)


class Pose2(NamedTuple):
    """Position in m and yaw in rad; yaw is not wrapped, so that turns can be counted."""

    x: float
    y: float
    yaw: float

    def moved(self, step: Pose2) -> Pose2:
        """This pose followed by ``step``, which is given in this pose's frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + c * step.x - s * step.y,
            self.y + s * step.x + c * step.y,
            self.yaw + step.yaw,
        )

    def relative_to(self, origin: Pose2) -> Pose2:
        """This pose as seen from ``origin``."""
        c, s = math.cos(origin.yaw), math.sin(origin.yaw)
        dx, dy = self.x - origin.x, self.y - origin.y
        return Pose2(c * dx + s * dy, c * dy - s * dx, self.yaw - origin.yaw)


ZERO_TWIST = Twist(0.0, 0.0, 0.0)
ORIGIN = Pose2(0.0, 0.0, 0.0)


def _sin_over(a: float) -> float:
    """sin(a) / a."""
    return 1.0 - a * a / 6.0 * (1.0 - a * a / 20.0) if abs(a) < 1e-3 else math.sin(a) / a


def _versin_over(a: float) -> float:
    """(1 - cos(a)) / a."""
    if abs(a) < 1e-3:
        return a / 2.0 * (1.0 - a * a / 12.0)
    half = math.sin(a / 2.0)
    return 2.0 * half * half / a


def exp(twist: Twist, dt: float) -> Pose2:
    """The motion of a constant twist over ``dt`` s: the exponential map of SE(2)."""
    dx, dy, a = twist.vx * dt, twist.vy * dt, twist.wz * dt
    s, v = _sin_over(a), _versin_over(a)
    return Pose2(s * dx - v * dy, v * dx + s * dy, a)


def chord_over_arc(angle: float) -> float:
    """How much shorter than its arc the chord of an arc of ``angle`` rad is."""
    return _sin_over(angle / 2.0)


def _product(a: Cov3, b: Cov3) -> Cov3:
    (a0, a1, a2), (b0, b1, b2) = a, b

    def row(r: Row3) -> Row3:
        return (
            r[0] * b0[0] + r[1] * b1[0] + r[2] * b2[0],
            r[0] * b0[1] + r[1] * b1[1] + r[2] * b2[1],
            r[0] * b0[2] + r[1] * b1[2] + r[2] * b2[2],
        )

    return (row(a0), row(a1), row(a2))


def congruent(a: Cov3, p: Cov3) -> Cov3:
    """A P A^T, exactly symmetric."""
    t: Cov3 = (
        (a[0][0], a[1][0], a[2][0]),
        (a[0][1], a[1][1], a[2][1]),
        (a[0][2], a[1][2], a[2][2]),
    )
    m = _product(_product(a, p), t)
    xy, xw, yw = (m[0][1] + m[1][0]) / 2, (m[0][2] + m[2][0]) / 2, (m[1][2] + m[2][1]) / 2
    return ((m[0][0], xy, xw), (xy, m[1][1], yw), (xw, yw, m[2][2]))


def propagate(covariance: Cov3, twist: Twist, twist_covariance: Cov3, dt: float) -> Cov3:
    """Pose covariance after ``dt`` s of a twist known up to ``twist_covariance``.

    P <- Ad P Ad^T + J Q J^T dt^2, with Ad the adjoint of the inverse motion
    and J the right Jacobian of SE(2) (Sola et al., "A micro Lie theory for
    state estimation in robotics", 2018, equations 161 and 163).
    """
    step = exp(twist, dt)
    c, s = math.cos(step.yaw), math.sin(step.yaw)
    # A small turn before the step moves its end, at t, by w x t: seen from there R^T (w x t).
    adjoint: Cov3 = (
        (c, s, c * -step.y + s * step.x),
        (-s, c, s * step.y + c * step.x),
        (0.0, 0.0, 1.0),
    )
    a = step.yaw
    dx, dy = twist.vx * dt, twist.vy * dt
    sa, va = _sin_over(a), _versin_over(a)
    if abs(a) < 1e-3:
        p, q = a / 6.0, 0.5
    else:
        p, q = (a - math.sin(a)) / (a * a), (1.0 - math.cos(a)) / (a * a)
    jacobian: Cov3 = (
        (sa, va, dx * p - dy * q),
        (-va, sa, dx * q + dy * p),
        (0.0, 0.0, 1.0),
    )
    moved = congruent(adjoint, covariance)
    noise = congruent(jacobian, twist_covariance)
    d2 = dt * dt

    def row(i: int) -> Row3:
        m, n = moved[i], noise[i]
        return (m[0] + n[0] * d2, m[1] + n[1] * d2, m[2] + n[2] * d2)

    return (row(0), row(1), row(2))
