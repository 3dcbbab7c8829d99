"""Rigid-body algebra in plain Python: vectors, unit quaternions, poses and inertias.

The compiler does not import numpy, because a cold build is faster without numpy. For vectors with
three elements, Python tuples are faster than numpy arrays. All quaternions of the project have the
order ``(w, x, y, z)``. A pose named ``X_AB`` is the pose of frame B in frame A, so ``X_AC = X_AB *
X_BC``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.number_origins import derived
from thorvaldc.model.sums import float_sum

GRAVITY = 9.81
"""Acceleration of free fall in m/s^2, equal to the default value of MuJoCo."""


Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Mat3 = tuple[Vec3, Vec3, Vec3]

ZERO3: Vec3 = (0.0, 0.0, 0.0)
IDENTITY_QUAT: Quat = (1.0, 0.0, 0.0, 0.0)


def clean(value: float) -> float:
    """Round a number to 12 significant digits. Numbers between -1e-12 and 1e-12 are rounded to 0.

    The results of ``sin`` and ``cos`` differ in the last bit between C libraries. Rounding to 12
    digits makes the numbers of the model equal on every machine.
    """
    if -1e-12 < value < 1e-12:
        return derived(0.0, value)
    return derived(float(format(float(value), ".12g")), value)


def clean3(v: Vec3) -> Vec3:
    return (clean(v[0]), clean(v[1]), clean(v[2]))


def add(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(s: float, a: Vec3) -> Vec3:
    return (s * a[0], s * a[1], s * a[2])


def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def norm(a: Vec3) -> float:
    return math.sqrt(dot(a, a))


def quat_multiply(p: Quat, q: Quat) -> Quat:
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


def quat_normalize(q: Quat) -> Quat:
    """Return the unit quaternion of the same rotation with a non-negative ``w``."""
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        n = -n
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def quat_from_rpy(roll: float, pitch: float, yaw: float) -> Quat:
    """Return the quaternion of a rotation by fixed-axis roll, pitch and yaw angles in rad.

    URDF uses the same convention for the roll, pitch and yaw angles.
    """
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def quat_from_axis_angle(axis: Vec3, angle: float) -> Quat:
    """Return the quaternion of a rotation by ``angle`` rad about the unit vector ``axis``."""
    s = math.sin(angle / 2)
    return (math.cos(angle / 2), s * axis[0], s * axis[1], s * axis[2])


def quat_from_z_to(axis: Vec3) -> Quat:
    """Return the quaternion of the smallest rotation from the z axis to the unit vector
    ``axis``."""
    c = dot((0.0, 0.0, 1.0), axis)
    if c < -1.0 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    x, y, z = cross((0.0, 0.0, 1.0), axis)
    return quat_normalize((1.0 + c, x, y, z))


def quat_to_matrix(q: Quat) -> Mat3:
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def matrix_to_rpy(r: Mat3) -> Vec3:
    """Return the fixed-axis roll, pitch and yaw angles in rad of a rotation matrix.

    The rotation matrix is R = Rz(yaw) Ry(pitch) Rx(roll), so the second row of the matrix Rz(-yaw)
    R contains cos(roll) and -sin(roll). The function computes the roll angle from cos(roll) and
    sin(roll). The three angles therefore reproduce the rotation matrix even at a pitch of +-90
    degrees, where ``asin`` loses half of the digits.
    """
    pitch = math.atan2(-r[2][0], math.hypot(r[0][0], r[1][0]))
    yaw = math.atan2(r[1][0], r[0][0]) if math.hypot(r[0][0], r[1][0]) > 1e-12 else 0.0
    s, c = math.sin(yaw), math.cos(yaw)
    roll = math.atan2(s * r[0][2] - c * r[1][2], c * r[1][1] - s * r[0][1])
    return (roll, pitch, yaw)


def rotate(q: Quat, v: Vec3) -> Vec3:
    w, x, y, z = q
    # v + 2 w (u x v) + 2 u x (u x v), with u the vector part; t = 2 u x v
    tx, ty, tz = 2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


@dataclass(frozen=True, slots=True)
class Pose:
    """The pose of one frame in another frame.

    - ``xyz``: position in m.
    - ``quat``: unit quaternion (w, x, y, z).
    """

    xyz: si.Position = ZERO3
    quat: Quat = IDENTITY_QUAT

    @staticmethod
    def from_xyz_rpy(xyz: Vec3 = ZERO3, rpy: Vec3 = ZERO3) -> Pose:
        if rpy == ZERO3:
            return Pose(xyz, derived(IDENTITY_QUAT, rpy))
        return Pose(xyz, quat_normalize(quat_from_rpy(*rpy)))

    def __mul__(self, other: Pose) -> Pose:
        xyz = add(self.xyz, rotate(self.quat, other.xyz))
        if other.quat == IDENTITY_QUAT:
            return Pose(xyz, derived(self.quat, other.quat))
        return Pose(xyz, quat_normalize(quat_multiply(self.quat, other.quat)))

    def inverse(self) -> Pose:
        w, x, y, z = self.quat
        q = (w, -x, -y, -z)
        return Pose(rotate(q, scale(-1.0, self.xyz)), q)

    def apply(self, point: Vec3) -> Vec3:
        """Return a point of the inner frame in coordinates of the outer frame."""
        return add(self.xyz, rotate(self.quat, point))

    def rotate(self, vector: Vec3) -> Vec3:
        return rotate(self.quat, vector)

    def rpy(self) -> Vec3:
        if self.quat == IDENTITY_QUAT:
            return derived(ZERO3, self.quat)
        return matrix_to_rpy(quat_to_matrix(self.quat))

    def clean(self) -> Pose:
        q = self.quat
        return Pose(clean3(self.xyz), (clean(q[0]), clean(q[1]), clean(q[2]), clean(q[3])))


@dataclass(frozen=True, slots=True)
class Inertial:
    """The mass of a body in kg, its centre of mass ``com`` in m and its inertia in kg m^2.

    ``inertia`` contains the moments of inertia ``(ixx, iyy, izz, ixy, ixz, iyz)`` about the centre
    of mass. The axes of ``inertia`` are parallel to the axes of the frame in which ``com`` is
    given. ``ixy``, ``ixz`` and ``iyz`` are elements of the inertia matrix, with the sign convention
    of URDF.
    """

    mass: si.Kilograms
    com: si.Position
    inertia: si.MomentsOfInertia

    def matrix(self) -> Mat3:
        xx, yy, zz, xy, xz, yz = self.inertia
        return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))

    def with_mass(self, mass: float) -> Inertial:
        """Return the body with another density, so that its mass is ``mass`` in kg."""
        xx, yy, zz, xy, xz, yz = (mass / self.mass * value for value in self.inertia)
        return Inertial(mass, self.com, (xx, yy, zz, xy, xz, yz))

    def transformed(self, pose: Pose) -> Inertial:
        """Return the mass and inertia of the body in the outer frame of ``pose``.

        With the rotation matrix R of the pose, the inertia matrix I becomes R I R^T in the outer
        frame.
        """
        if pose.quat == IDENTITY_QUAT:
            inertia = derived(self.inertia, pose.quat)
            return Inertial(self.mass, pose.apply(self.com), inertia)
        r = quat_to_matrix(pose.quat)
        m = self.matrix()
        rm = [[float_sum(r[i][k] * m[k][j] for k in range(3)) for j in range(3)] for i in range(3)]

        def entry(i: int, j: int) -> float:
            return rm[i][0] * r[j][0] + rm[i][1] * r[j][1] + rm[i][2] * r[j][2]

        return Inertial(
            self.mass,
            pose.apply(self.com),
            (entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)),
        )

    def clean(self) -> Inertial:
        """Round the mass and inertia with ``clean`` and keep the inertia physically possible.

        The largest principal moment of a body is at most the sum of the other two principal
        moments. For a flat plate, the largest principal moment is equal to the sum of the other two
        principal moments. Rounding can make the largest principal moment slightly too large, and
        simulators reject an inertia that is not physically possible. The method then increases all
        three principal moments by the same value, at most 1e-6 of the largest principal moment.
        """
        low, middle, high = self.principal_moments()
        excess = high - low - middle
        lift = 0.0
        if -1e-9 * high < excess <= 1e-6 * high + 1e-12:
            lift = excess + 2e-9 * high
        xx, yy, zz, xy, xz, yz = self.inertia
        return Inertial(
            clean(self.mass),
            clean3(self.com),
            (clean(xx + lift), clean(yy + lift), clean(zz + lift), clean(xy), clean(xz), clean(yz)),
        )

    def principal_moments(self) -> Vec3:
        """Return the eigenvalues of the inertia matrix in ascending order, in kg m^2."""
        return symmetric_eigenvalues(self.matrix())


def combine(bodies: list[Inertial]) -> Inertial:
    """Return the mass and inertia of several bodies as one body (parallel-axis theorem).

    The mass and inertia of all bodies must be given in the same frame.
    """
    mass = float_sum(b.mass for b in bodies)
    if mass <= 0.0:
        return Inertial(0.0, ZERO3, (0.0,) * 6)
    com: Vec3 = (
        float_sum(b.mass * b.com[0] for b in bodies) / mass,
        float_sum(b.mass * b.com[1] for b in bodies) / mass,
        float_sum(b.mass * b.com[2] for b in bodies) / mass,
    )
    xx = yy = zz = xy = xz = yz = 0.0
    for b in bodies:
        x, y, z = sub(b.com, com)
        i = b.inertia
        xx += i[0] + b.mass * (y * y + z * z)
        yy += i[1] + b.mass * (x * x + z * z)
        zz += i[2] + b.mass * (x * x + y * y)
        xy += i[3] - b.mass * x * y
        xz += i[4] - b.mass * x * z
        yz += i[5] - b.mass * y * z
    return Inertial(mass, com, (xx, yy, zz, xy, xz, yz))


def symmetric_eigenvalues(m: Mat3) -> Vec3:
    """Return the eigenvalues of a symmetric 3x3 matrix in ascending order.

    The trigonometric formula is from Smith, "Eigenvalues of a symmetric 3 x 3 matrix",
    Communications of the ACM 4, 1961. With q = tr(M) / 3, p^2 = tr((M - q)^2) / 6 and B = (M - q) /
    p, the eigenvalues are q + 2 p cos(phi + 2 pi k / 3), where phi = arccos(det(B) / 2) / 3 and k =
    0, 1, 2.
    """
    largest = max(abs(number) for row in m for number in row)
    if largest > 1e150:  # the squares of such numbers overflow
        x, y, z = ((r[0] / largest, r[1] / largest, r[2] / largest) for r in m)
        low, middle, high = symmetric_eigenvalues((x, y, z))
        return (low * largest, middle * largest, high * largest)
    p1 = m[0][1] ** 2 + m[0][2] ** 2 + m[1][2] ** 2
    q = (m[0][0] + m[1][1] + m[2][2]) / 3
    p2 = (m[0][0] - q) ** 2 + (m[1][1] - q) ** 2 + (m[2][2] - q) ** 2 + 2 * p1
    if p2 == 0.0:
        return (q, q, q)
    p = math.sqrt(p2 / 6)
    b = [[(m[i][j] - (q if i == j else 0.0)) / p for j in range(3)] for i in range(3)]
    det = (
        b[0][0] * (b[1][1] * b[2][2] - b[1][2] * b[2][1])
        - b[0][1] * (b[1][0] * b[2][2] - b[1][2] * b[2][0])
        + b[0][2] * (b[1][0] * b[2][1] - b[1][1] * b[2][0])
    )
    phi = math.acos(max(-1.0, min(1.0, det / 2))) / 3
    high = q + 2 * p * math.cos(phi)
    low = q + 2 * p * math.cos(phi + 2 * math.pi / 3)
    return (low, 3 * q - high - low, high)
