"""The soft contact between a wheel and the ground as in MuJoCo, computed with formulas and without
MuJoCo.

Normal force. A wheel sinks into the ground until the contact force is equal to the wheel load.
MuJoCo computes the contact force from a regularisation R and a reference acceleration a_ref (MuJoCo
documentation, chapter "Computation", section "Solver parameters"). Normal force f of a wheel at
rest:

    f = a_ref / R,   a_ref = k d(p) p,   R = A (1 - d(p)) / d(p),
    k = 1 / (d_max timeconst dampratio)^2.

The symbols are:

- p: penetration in m.
- d(p): impedance curve of ``solimp``.
- A: inverse weight of the wheel's body in 1/kg, see ``mass_matrix.inverse_weights``. For wheels
  with a larger damping ratio, A is the effective inverse weight, see below.

Normal force f(p) and its derivative f'(p) as functions of the penetration p:

    f(p) = k p d^2 / (A (1 - d)),
    f'(p) = k / A * (d^2 / (1 - d) + p d' d (2 - d) / (1 - d)^2).

Equal penetration. With equal ``solref`` of all wheels, the stiffness of a contact is proportional
to 1 / A. The inverse weight A is larger at the corners of a robot than in its middle. A rigid robot
with more than four wheels would then stand mainly on its middle wheels. The stiffness of a real
tyre does not depend on the inverse weight of the robot. ``softened_weights`` therefore chooses an
effective inverse weight A' of each wheel, such that all wheels sink in equally under the static
loads N of the model:

    A' = max over wheels (A N) / N.

A damping ratio of sqrt(A' / A) times the default has the effect of the inverse weight A', because
the force is proportional to k / A and k to 1 / dampratio^2. A longer time constant would have the
same effect at rest, but not in motion: it lowers the damping b = 2 / (d_max timeconst), which also
holds a wheel against creep along the ground. With a lower damping, wheels creep more, and the
odometry drifts. The damping ratio is never smaller than the default, because a softer contact only
sinks in further, while a stiffer one could vibrate.

Rolling radius. MuJoCo puts the contact point above the lowest point of the wheel's shape, by half
of the penetration. In MuJoCo, a wheel therefore rolls on a smaller radius than the radius of its
collision shape. The MJCF backend makes the collision shape of each wheel larger to correct the
rolling radius. With the larger collision shape, the contact point lies on a circle of
``Wheel.radius`` in the middle plane of the wheel.

The ground is at the height 0, and the contact point is at the height -p/2, where p is the
penetration. The lowest point of the rolling circle is at the height h - radius cos(camber), where h
is the height of the wheel centre. The contact point is the lowest point of the rolling circle.
Penetration p:

    p = 2 (radius cos(camber) - h).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.model import Vec3, Wheel
from thorvaldc.model.spatial import clean

SOLREF = (0.01, 1.0)
"""MuJoCo's ``solref`` of a wheel: time constant in s and damping ratio."""
SOLIMP = (0.02, 0.95, 0.002)
"""MuJoCo's ``solimp`` of a wheel: d at penetration 0, d_max, and the width of the curve in m."""

_STIFFNESS = 1.0 / (SOLIMP[1] * SOLREF[0] * SOLREF[1]) ** 2
_LARGEST_SOFTENING = 16.0
_MIN_COS_CAMBER = 0.2  # beyond 78 degrees a wheel lies on its side and does not roll
_MAX_ITERATIONS = 60


class WheelContact(NamedTuple):
    """The ellipsoid that represents a wheel in contact simulations, in the link frame of the wheel.

    - ``axis``: spin axis as a unit vector from the right to the left side of the robot.
    - ``radius``, ``half_width``: radial and axial half axis of the ellipsoid in m.
    - ``offset``: position of the centre of the ellipsoid on the spin axis in m.
    - ``penetration``: penetration of the wheel into the ground in m, for a robot at rest.
    - ``force``: vertical contact force in N, for a robot at rest.
    - ``damping_ratio``: second value of MuJoCo's ``solref``.
    """

    axis: Vec3
    radius: float
    half_width: float
    offset: float
    penetration: float
    force: float
    damping_ratio: float = SOLREF[1]


def impedance(penetration: float) -> float:
    """Return the impedance of MuJoCo's ``solimp`` with the default midpoint 0.5 and power 2."""
    d0, d1, width = SOLIMP
    x = penetration / width
    if x >= 1.0:
        return d1
    y = 2.0 * x * x if x <= 0.5 else 1.0 - 2.0 * (1.0 - x) ** 2
    return d0 + y * (d1 - d0)


def normal_force(penetration: float, inverse_weight: float) -> float:
    """Return the normal force in N between a wheel and the ground.

    ``penetration`` is the depth in m by which the wheel sinks into the ground. ``inverse_weight``
    is the inverse weight of the wheel's link in 1/kg.
    """
    if penetration <= 0.0:
        return 0.0
    d = impedance(penetration)
    return _STIFFNESS * penetration * d * d / ((1.0 - d) * inverse_weight)


def contact_stiffness(penetration: float, inverse_weight: float) -> float:
    """Return the contact stiffness of a wheel in N/m: the derivative of the normal force.

    Penetrations of the wheel below 1e-6 m are replaced by 1e-6 m. The contact stiffness is
    therefore never zero, and Newton's method also works for a wheel above the ground.
    """
    p = max(penetration, 1e-6)
    d0, d1, width = SOLIMP
    d = impedance(p)
    x = p / width
    rise = 0.0 if x >= 1.0 else (d1 - d0) / width * 4.0 * (x if x <= 0.5 else 1.0 - x)
    scale = _STIFFNESS / inverse_weight
    return scale * (d * d / (1 - d) + p * rise * d * (2 - d) / (1 - d) ** 2)


def penetration_under(force: float, inverse_weight: float) -> float:
    """Return the penetration of a wheel in m at which the normal force is ``force`` N.

    The function finds the penetration with Newton's method inside a bracket. If a Newton step
    leaves the bracket, the function bisects the bracket.
    """
    if force <= 0.0:
        return 0.0
    low, high = 0.0, 1e-3
    while normal_force(high, inverse_weight) < force:
        high *= 2.0
    p = high
    for _ in range(_MAX_ITERATIONS):
        error = normal_force(p, inverse_weight) - force
        if error > 0.0:
            high = p
        else:
            low = p
        better = p - error / contact_stiffness(p, inverse_weight)
        if not low < better < high:
            better = (low + high) / 2
        if abs(better - p) < 1e-15:
            break
        p = better
    return p


def softened_weights(weights: Sequence[float], loads: Sequence[float]) -> list[float]:
    """Return the effective inverse weight in 1/kg of each wheel for equal penetrations.

    ``weights`` are the inverse weights of the wheels' links in 1/kg, ``loads`` the static wheel
    loads in N. A wheel without load keeps its inverse weight. The effective inverse weight is at
    most ``_LARGEST_SOFTENING`` times the inverse weight.
    """
    largest = max((w * n for w, n in zip(weights, loads, strict=True)), default=0.0)
    return [
        min(largest / load, _LARGEST_SOFTENING * weight) if load > 0.0 else weight
        for weight, load in zip(weights, loads, strict=True)
    ]


def contact_ellipsoid(
    wheel: Wheel, axis: Vec3, penetration: float, force: float, tilt: float
) -> WheelContact:
    """Return the ellipsoid whose contact point lies on the rolling circle of the wheel.

    ``axis`` is the spin axis of the wheel in the link frame. ``tilt`` is the vertical component of
    the wheel's spin axis in the world frame, which is the sine of the camber angle.

    The ellipsoid of the wheel has the radial half axis a and the axial half axis b = width / 2. All
    points of the derivation are in the plane of the spin axis and the vertical. With c =
    cos(camber), s = sin(camber) and H^2 = a^2 c^2 + b^2 s^2, the lowest point has the radius a^2 c
    / H and the axial position b^2 s / H. The contact point is p/2 above the lowest point of the
    ellipsoid, at the radius a^2 c / H - p/2 c, where p is the penetration. Conditions for the
    ellipsoid of the wheel:

    - The radius of the contact point must be ``wheel.radius``: a^2 c / H = wheel.radius + p/2 c =:
      r. Equation for a, with q = b s / c: a^4 - r^2 a^2 - r^2 q^2 = 0. The positive solution is a^2
      = r^2 (1 + sqrt(1 + 4 (q / r)^2)) / 2.
    - The contact point must lie in the middle plane of the wheel. The centre of the ellipsoid is
      therefore shifted along the spin axis by (b^2 / H - p/2) s.
    """
    cos = math.sqrt(max(1.0 - tilt * tilt, 0.0))
    half = wheel.width / 2
    rolling = wheel.radius + penetration / 2
    if cos < _MIN_COS_CAMBER:
        return WheelContact(axis, clean(rolling), half, 0.0, clean(penetration), clean(force))
    r = wheel.radius + penetration / 2 * cos
    q = half * tilt / cos
    a = r * math.sqrt((1.0 + math.sqrt(1.0 + 4.0 * (q / r) ** 2)) / 2.0)
    height = math.hypot(a * cos, half * tilt)
    offset = (half * half / height - penetration / 2) * tilt
    return WheelContact(axis, clean(a), half, clean(offset), clean(penetration), clean(force))


class RollingSphere(NamedTuple):
    """A sphere that represents a wheel in contact simulations with rigid contacts.

    ``center`` is in the link frame of the wheel. ``radius`` and ``center`` are in m.
    """

    radius: float
    center: Vec3


def rolling_sphere(radius: float, axis: Vec3, tilt: float) -> RollingSphere:
    """Return the sphere whose lowest point is the lowest point of the rolling circle.

    ``radius`` is the rolling radius of the wheel in m, ``axis`` its spin axis in the link frame,
    and ``tilt`` the vertical component of the spin axis in the world frame, which is the sine of
    the camber angle.

    The rolling circle lies in the middle plane of the wheel. Its lowest point is below the wheel
    centre by radius cos(camber), and beside it by radius sin(camber). The centre of the sphere is
    on the spin axis and above this point, so that the radius of the sphere is radius / cos(camber)
    and its centre is shifted along the spin axis by radius tan(camber).
    """
    cos = math.sqrt(max(1.0 - tilt * tilt, 0.0))
    if cos < _MIN_COS_CAMBER:
        return RollingSphere(radius, (0.0, 0.0, 0.0))
    shift = radius * tilt / cos
    x, y, z = axis
    return RollingSphere(
        clean(radius / cos), (clean(shift * x), clean(shift * y), clean(shift * z))
    )
