"""Planar motion on SE(2): twists, poses, exact integration of twists, and covariances.

A twist is the velocity of ``base_link`` in its own frame.  A pose is the position and yaw of
``base_link`` in the odometry frame.  Covariances have the order x, y, yaw (or vx, vy, wz).  The
covariance of a pose describes a small motion in ``base_link`` (a right perturbation), so it does
not depend on the position of the robot.

Exponential map: a robot that moves with a constant twist for the time dt turns by the angle a = wz
dt.  In the frame at the start of the motion, the velocity of the robot at the time t is R(wz t) v.
Integral of the velocity over 0 <= t <= dt:

    [ sin a / a       -(1 - cos a) / a ]
    [ (1 - cos a) / a   sin a / a      ]  v dt

For small angles a, the quotients are computed by Taylor series.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from thorvaldc.model.spatial import quat_from_rpy

Row3 = tuple[float, float, float]
Cov3 = tuple[Row3, Row3, Row3]

ZERO_COV: Cov3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Twist(NamedTuple):
    """Velocity of ``base_link`` in its own frame.

    - ``vx``: forward speed, m/s.
    - ``vy``: speed to the left, m/s.
    - ``wz``: yaw rate, rad/s.
    """

    vx: float
    vy: float
    wz: float

    def scaled(self, factor: float) -> Twist:
        """Returns the twist with each component multiplied by ``factor``."""
        return Twist(self.vx * factor, self.vy * factor, self.wz * factor)

    def minus(self, other: Twist) -> Twist:
        """Returns the difference to another twist."""
        return Twist(self.vx - other.vx, self.vy - other.vy, self.wz - other.wz)

    def towards(self, other: Twist, share: float) -> Twist:
        """Returns the twist at a share of the straight line from this twist to ``other``."""
        (ux, uy, uw), (vx, vy, wz) = self, other
        return Twist(ux + share * (vx - ux), uy + share * (vy - uy), uw + share * (wz - uw))

    @property
    def finite(self) -> bool:
        """Whether no component is infinite or nan."""
        return math.isfinite(self.vx) and math.isfinite(self.vy) and math.isfinite(self.wz)

    @property
    def speed(self) -> float:
        """Speed of the origin of ``base_link``, m/s."""
        return math.hypot(self.vx, self.vy)


class Pose2(NamedTuple):
    """Position and yaw of a frame in the plane.

    - ``x``, ``y``: position, m.
    - ``yaw``: yaw angle, rad.  The angle is not wrapped, so it counts full turns.
    """

    x: float
    y: float
    yaw: float

    def moved(self, step: Pose2) -> Pose2:
        """Returns the pose after the motion ``step``, which is relative to the present pose."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + c * step.x - s * step.y,
            self.y + s * step.x + c * step.y,
            self.yaw + step.yaw,
        )

    def relative_to(self, origin: Pose2) -> Pose2:
        """Returns the pose relative to the pose ``origin``."""
        c, s = math.cos(origin.yaw), math.sin(origin.yaw)
        dx, dy = self.x - origin.x, self.y - origin.y
        return Pose2(c * dx + s * dy, c * dy - s * dx, self.yaw - origin.yaw)


ZERO_TWIST: Final = Twist(0.0, 0.0, 0.0)
ORIGIN: Final = Pose2(0.0, 0.0, 0.0)


def _sin_over(a: float) -> float:
    """Returns sin(a) / a for an angle a in rad."""
    return 1.0 - a * a / 6.0 * (1.0 - a * a / 20.0) if abs(a) < 1e-3 else math.sin(a) / a


def _versin_over(a: float) -> float:
    """Returns (1 - cos(a)) / a for an angle a in rad."""
    if abs(a) < 1e-3:
        return a / 2.0 * (1.0 - a * a / 12.0)
    half = math.sin(a / 2.0)
    return 2.0 * half * half / a


def exp(twist: Twist, dt: float) -> Pose2:
    """Returns the motion of a robot that moves with a constant twist for ``dt`` s.

    The function ``exp`` is the exponential map of SE(2).
    """
    dx, dy, a = twist.vx * dt, twist.vy * dt, twist.wz * dt
    s, v = _sin_over(a), _versin_over(a)
    return Pose2(s * dx - v * dy, v * dx + s * dy, a)


def chord_over_arc(angle: float) -> float:
    """Returns the ratio of chord length to arc length for an arc of ``angle`` rad."""
    return _sin_over(angle / 2.0)


def _planar(c: float, s: float, a: float, b: float, p: Cov3) -> Cov3:
    """Returns the matrix product M P M' with M = [[c, s, a], [-s, c, b], [0, 0, 1]].

    The resulting matrix is exactly symmetric, without rounding errors.
    """
    (p11, p12, p13), (_, p22, p23), (_, _, p33) = p
    r13, r23 = c * p13 + s * p23, c * p23 - s * p13
    r11 = c * c * p11 + 2.0 * c * s * p12 + s * s * p22
    r12 = c * s * (p22 - p11) + (c * c - s * s) * p12
    r22 = s * s * p11 - 2.0 * c * s * p12 + c * c * p22
    m13, m23 = r13 + a * p33, r23 + b * p33
    m12 = r12 + a * r23 + b * r13 + a * b * p33
    return (
        (r11 + 2.0 * a * r13 + a * a * p33, m12, m13),
        (m12, r22 + 2.0 * b * r23 + b * b * p33, m23),
        (m13, m23, p33),
    )


def seen_from(pose: Pose2, covariance: Cov3) -> Cov3:
    """Converts the covariance of a small motion of the odometry frame about its origin.

    The result is the covariance of the same small motion, expressed in ``base_link`` at ``pose``.
    The conversion is the adjoint of the inverse of ``pose``.
    """
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return _planar(c, s, s * x - c * y, s * y + c * x, covariance)


def combine(p: Cov3, q: Cov3, factor: float = 1.0) -> Cov3:
    """Returns the sum P + factor Q of two symmetric matrices."""
    (p11, p12, p13), (_, p22, p23), (_, _, p33) = p
    (q11, q12, q13), (_, q22, q23), (_, _, q33) = q
    k12, k13, k23 = p12 + factor * q12, p13 + factor * q13, p23 + factor * q23
    return (
        (p11 + factor * q11, k12, k13),
        (k12, p22 + factor * q22, k23),
        (k13, k23, p33 + factor * q33),
    )


def integrate(
    covariance: Cov3,
    twist: Twist,
    twist_covariance: Cov3,
    dt: float,
    correlation: float = 0.0,
) -> tuple[Pose2, Cov3]:
    """Integrates a constant twist over ``dt`` s.

    Returns the motion, as computed by ``exp``, and the covariance of the pose after the motion.
    Change of the covariance P of the pose:

        P <- Ad P Ad' + J Q J' dt^2

    In this formula, Q is the covariance of the twist, Ad is the adjoint of the inverse motion, and
    J is the right Jacobian of SE(2) (Sola et al., "A micro Lie theory for state estimation in
    robotics", 2018, equations 161 and 163).

    With ``correlation`` = 0, the twist errors of two steps are independent.  If ``correlation`` is
    positive, the correlation of the errors decreases with the time constant ``correlation`` (s), by
    the factor r = exp(-dt / correlation) per step.  Over a time n dt much longer than the time
    constant, the variance of a sum of n errors is n Q (1 + 2 r + 2 r^2 + ...) = n Q (1 + r) / (1 -
    r) = n Q / tanh(dt / (2 correlation)).  For times that are not much longer than the time
    constant, the formula overestimates the variance.
    """
    dx, dy, angle = twist.vx * dt, twist.vy * dt, twist.wz * dt
    sine = math.sin(angle)
    if abs(angle) < 1e-3:
        s, v, p, q = _sin_over(angle), _versin_over(angle), angle / 6.0, 0.5
    else:
        v = _versin_over(angle)
        s, p, q = sine / angle, (angle - sine) / (angle * angle), v / angle
    d2 = dt * dt
    if correlation > 0.0:
        d2 /= math.tanh(dt / (2.0 * correlation))
    turn = (math.cos(angle), sine, s, v, p, q)
    motion = Pose2(s * dx - v * dy, v * dx + s * dy, angle)
    return motion, propagated(covariance, twist_covariance, dx, dy, turn, d2)


def propagated(
    covariance: Cov3,
    noise: Cov3,
    dx: float,
    dy: float,
    turn: tuple[float, float, float, float, float, float],
    d2: float,
) -> Cov3:
    """Returns the covariance of the pose after one step of ``integrate``.

    - ``covariance``: covariance P of the pose before the step.
    - ``noise``: covariance Q of the twist.
    - ``dx``, ``dy``: velocity multiplied by the time, m.
    - ``turn``: of the angle a of the step: cos a, sin a, sin a / a, (1 - cos a) / a,
      (a - sin a) / a^2 and (1 - cos a) / a^2.
    - ``d2``: factor of Q, s^2.
    """
    c, s, sa, va, p, q = turn
    x, y = sa * dx - va * dy, va * dx + sa * dy  # the motion t in this step, as in `exp`
    # Adjoint Ad of the motion: a small rotation w before the motion t moves the final position by w
    # x t.  In the frame at the end of the motion, the final position moves by R' (w x t).
    moved = _planar(c, s, s * x - c * y, s * y + c * x, covariance)
    added = _planar(sa, va, dx * p - dy * q, dx * q + dy * p, noise)
    (m11, m12, m13), (_, m22, m23), (_, _, m33) = moved
    (n11, n12, n13), (_, n22, n23), (_, _, n33) = added
    k12, k13, k23 = m12 + d2 * n12, m13 + d2 * n13, m23 + d2 * n23
    return (
        (m11 + d2 * n11, k12, k13),
        (k12, m22 + d2 * n22, k23),
        (k13, k23, m33 + d2 * n33),
    )


def parse_twist(text: str) -> Twist:
    """Parses a twist in the form ``vx,vy,wz`` (m/s, m/s, rad/s).

    Raises ``ValueError`` if the text is not three finite numbers.
    """
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 3 and Twist(*numbers).finite:
        return Twist(*numbers)
    raise ValueError(
        f"{text!r} is not a twist of three finite numbers: forward m/s, leftward m/s and turning"
        " rad/s, such as 1,0,0.3"
    )


def twist_text(twist: Twist, digits: int = 3) -> str:
    """Returns a twist with its units, such as ``(1 m/s, 0 m/s, 0.3 rad/s)``."""
    vx, vy, wz = (f"{value:.{digits}g}" for value in twist)
    return f"({vx} m/s, {vy} m/s, {wz} rad/s)"


# -- the numbers of ROS messages: poses, twists and covariances of a planar robot ---------------

Posture = tuple[float, float, float]
"""Height (m), roll and pitch (rad)."""
LEVEL: Posture = (0.0, 0.0, 0.0)
_UNKNOWN_COVARIANCE = (0.0,) * 36


def pose_numbers(pose: Pose2, posture: Posture = LEVEL) -> tuple[float, ...]:
    """Returns the numbers of a ROS pose: x, y, z (m) and a quaternion xyzw."""
    z, roll, pitch = posture
    w, i, j, k = quat_from_rpy(roll, pitch, pose.yaw)
    return pose.x, pose.y, z, i, j, k, w


def twist_numbers(twist: Twist) -> tuple[float, ...]:
    """Returns the numbers of a ROS twist: linear velocity x, y, z and angular velocity x, y, z."""
    return twist.vx, twist.vy, 0.0, 0.0, 0.0, twist.wz


def covariance_numbers(planar: Cov3, yaw: float = 0.0) -> tuple[float, ...]:
    """Returns the numbers of a ROS covariance, a 6x6 matrix of (x, y, z, roll, pitch, yaw) by rows.

    ``planar`` is the covariance C of (x, y, yaw).  The frame of ``planar`` is rotated by the angle
    ``yaw`` (rad) relative to the frame of the message.  The covariance in the frame of the message
    is R C R^T with the rotation matrix R.  By ROS convention, the value zero means an unknown
    covariance.
    """
    if planar is ZERO_COV:
        return _UNKNOWN_COVARIANCE
    (xx, xy, xa), (_, yy, ya), (_, _, aa) = planar
    if yaw:
        c, s = math.cos(yaw), math.sin(yaw)
        xx, xy, yy = (
            c * c * xx - 2.0 * c * s * xy + s * s * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            s * s * xx + 2.0 * c * s * xy + c * c * yy,
        )
        xa, ya = c * xa - s * ya, s * xa + c * ya
    x_and_y_rows = (xx, xy, 0.0, 0.0, 0.0, xa, xy, yy, 0.0, 0.0, 0.0, ya)
    return (*x_and_y_rows, *_UNKNOWN_COVARIANCE[:18], xa, ya, 0.0, 0.0, 0.0, aa)
