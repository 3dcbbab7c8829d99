"""A wheel in MuJoCo's soft contact, in closed form and without MuJoCo.

A wheel sinks into the ground until the contact carries its load.  At rest the
normal force of MuJoCo's constraint is (documentation, "Computation", solver
parameters)

    f = a_ref / R,   a_ref = k d(p) p,   R = (1 - d(p)) / d(p) * A,
    k = 1 / (d_max^2 timeconst^2 dampratio^2),

with p the penetration, d(p) the impedance curve of ``solimp`` and A the inverse
weight of the wheel's body (``mass_matrix.inverse_weights``).

MuJoCo puts the contact point half of the penetration above the lowest point,
so a wheel rolls on less than its collision radius.  Every wheel is therefore
grown until that point lies on a circle of ``Wheel.radius`` in the wheel's
middle plane, for which

    p = 2 (radius cos(camber) - height of the centre).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.model import Wheel
from thorvaldc.model.spatial import clean

SOLREF = (0.01, 1.0)
SOLIMP = (0.02, 0.95, 0.002)

_STIFFNESS = 1.0 / (SOLIMP[1] * SOLREF[0] * SOLREF[1]) ** 2
_MIN_COS_CAMBER = 0.2
_MAX_ITERATIONS = 60


class WheelContact(NamedTuple):
    """The ellipsoid that stands for a wheel on the ground, in the wheel link's frame.

    ``radius`` and ``half_width`` are its half axes in m, ``offset`` (m) is how far its
    centre lies from the link's origin along the spin axis.  ``penetration`` in
    m and ``force`` in N are those of the settled robot.
    """

    radius: float
    half_width: float
    offset: float
    penetration: float
    force: float


def impedance(penetration: float) -> float:
    """``d(p)`` of ``solimp`` with MuJoCo's default midpoint 0.5 and power 2."""
    d0, d1, width = SOLIMP
    x = penetration / width
    if x >= 1.0:
        return d1
    y = 2.0 * x * x if x <= 0.5 else 1.0 - 2.0 * (1.0 - x) ** 2
    return d0 + y * (d1 - d0)


def normal_force(penetration: float, inverse_weight: float) -> float:
    """Force in N at rest, for ``inverse_weight`` (1/kg) of the wheel's body."""
    if penetration <= 0.0:
        return 0.0
    d = impedance(penetration)
    return _STIFFNESS * penetration * d * d / ((1.0 - d) * inverse_weight)


def slope(penetration: float, inverse_weight: float) -> float:
    """Derivative of ``normal_force``; never zero, so that a lifted wheel can come down."""
    p = max(penetration, 1e-6)
    d0, d1, width = SOLIMP
    d = impedance(p)
    x = p / width
    rise = 0.0 if x >= 1.0 else (d1 - d0) / width * 4.0 * (x if x <= 0.5 else 1.0 - x)
    scale = _STIFFNESS / inverse_weight
    return scale * (d * d / (1 - d) + p * rise * d * (2 - d) / (1 - d) ** 2)


def penetration_under(force: float, inverse_weight: float) -> float:
    """The penetration in m at which the contact carries ``force`` N."""
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
        step = p - error / slope(p, inverse_weight)
        if not low < step < high:
            step = (low + high) / 2
        if abs(step - p) < 1e-15:
            break
        p = step
    return p


def ellipsoid(wheel: Wheel, penetration: float, force: float, tilt: float) -> WheelContact:
    """The ellipsoid that touches on the wheel's own circle; ``tilt``: spin axis, z component."""
    cos = math.sqrt(max(1.0 - tilt * tilt, 0.0))
    half = wheel.width / 2
    rolling = wheel.radius + penetration / 2
    if cos < _MIN_COS_CAMBER:
        return WheelContact(clean(rolling), half, 0.0, clean(penetration), clean(force))
    # Half axes a (radial) and b (axial); lowest point at radius a^2 cos/H and
    # b^2 sin/H along the axis, H^2 = a^2 cos^2 + b^2 sin^2; the contact half of
    # the penetration above it.  Radius of the contact = wheel.radius gives a,
    # its place along the axis = 0 gives the offset.
    at = wheel.radius + penetration / 2 * cos
    slant = half * tilt / cos
    a = at * math.sqrt((1.0 + math.sqrt(1.0 + 4.0 * (slant / at) ** 2)) / 2.0)
    height = math.hypot(a * cos, half * tilt)
    offset = (half * half / height - penetration / 2) * tilt
    return WheelContact(clean(a), half, clean(offset), clean(penetration), clean(force))
