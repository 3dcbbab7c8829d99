"""Which motions the wheels of a robot allow without slip, and its tightest turn.

The notation follows Campion, Bastin and d'Andrea-Novel, "Structural properties and classification
of kinematic and dynamic models of wheeled mobile robots" (1996). Condition that a wheel at the
position (x, y) with the heading angle b does not slide sideways when the robot moves with the twist
(vx, vy, wz):

    (-sin b, cos b, x cos b + y sin b) . (vx, vy, wz) = 0          (lateral row).

Condition that a driven wheel rolls with the speed v along the heading:

    (cos b, sin b, x sin b - y cos b) . (vx, vy, wz) = v           (rolling row).

Tightest turn. The robot turns about the centre c = (cx, cy) with the twist (cy, -cx, 1). A fixed
wheel allows the centres on its axle. A steered wheel allows the centres on its axle at any steering
angle within the limits; the border of this area consists of the axles at the two limits. The
nearest allowed centre to the origin of ``base_link`` is therefore the origin, the nearest point of
an axle (of a fixed wheel, or at a limit), or the intersection of two axles. The module tries them
all. For a steered wheel with a trail the area also ends at a circle, which is not tried.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.model import Joint, Robot, Wheel
from thorvaldc.model.sums import float_sum

Row = tuple[float, float, float]
Twist = tuple[float, float, float]
"""Velocity along x and y in m/s and yaw rate in rad/s, in ``base_link``."""
Center = tuple[float, float]
"""Centre of rotation (x, y) in ``base_link`` in m."""

_TOLERANCE = 1e-6
"""Side slip in m/s at 1 m/s or 1 rad/s, and distance from a limit in rad, that count as zero."""


def feasible_twists(robot: Robot) -> int:
    """Returns the number of independent twists that the fixed wheels allow, from 0 to 3."""
    return 3 - rank(fixed_rows(robot))


def fixed_rows(robot: Robot) -> list[Row]:
    """Returns the lateral rows of all wheels that neither steer nor swivel."""
    return [
        lateral_row(wheel, wheel.heading)
        for wheel in robot.wheels
        if wheel.steering_joint is None and wheel.swivel_joint is None
    ]


def cannot_turn(robot: Robot) -> bool:
    """Returns true if the fixed wheels prevent the robot from turning.

    The fixed wheels prevent the robot from turning if the vector (0, 0, 1) is a linear combination
    of the lateral rows.
    """
    rows = fixed_rows(robot)
    return rank([*rows, (0.0, 0.0, 1.0)]) == rank(rows)


def lateral_row(wheel: Wheel, angle: float) -> Row:
    """Returns the lateral row of a wheel with the heading ``angle`` (rad)."""
    x, y = wheel.contact_point
    c, s = math.cos(angle), math.sin(angle)
    return (-s, c, c * x + s * y)


def rolling_row(wheel: Wheel, angle: float) -> Row:
    """Returns the rolling row of a wheel with the heading ``angle`` (rad)."""
    x, y = wheel.contact_point
    c, s = math.cos(angle), math.sin(angle)
    return (c, s, s * x - c * y)


def rank(rows: Sequence[Row], tolerance: float = 1e-4) -> int:
    """Computes the rank of a matrix with three columns by the Gram-Schmidt process.

    A matrix row is linearly dependent on the earlier rows if the length of the orthogonal component
    is at most ``tolerance`` (m).
    """
    basis: list[Row] = []
    for row in sorted(rows, key=lambda r: -float_sum(v * v for v in r)):
        remainder = list(row)
        for b in basis:
            projection = float_sum(r * v for r, v in zip(remainder, b, strict=True))
            remainder = [r - projection * v for r, v in zip(remainder, b, strict=True)]
        length = math.sqrt(float_sum(r * r for r in remainder))
        if length > tolerance:
            basis.append((remainder[0] / length, remainder[1] / length, remainder[2] / length))
    return len(basis)


def roll_speeds(robot: Robot, twist: Twist) -> dict[str, float] | None:
    """Return the rolling speed in m/s of each wheel, at steering angles without slip.

    The keys are the names of the wheels; wheels that swivel are left out. Returns ``None`` if a
    wheel would slip at all steering angles within its limits.
    """
    joints = {joint.name: joint for joint in robot.joints}
    speeds = {}
    for wheel in robot.wheels:
        if wheel.swivel_joint is not None:
            continue
        if wheel.steering_joint is None:
            if abs(_product(lateral_row(wheel, wheel.heading), twist)) > _TOLERANCE:
                return None
            speeds[wheel.name] = _product(rolling_row(wheel, wheel.heading), twist)
            continue
        speed = _steered_roll_speed(wheel, joints[wheel.steering_joint], twist)
        if speed is None:
            return None
        speeds[wheel.name] = speed
    return speeds


def _steered_roll_speed(wheel: Wheel, steering: Joint, twist: Twist) -> float | None:
    """Return the rolling speed of a steered wheel, or ``None`` if it would slip.

    The velocity u of the steering axis has the direction b - asin(trail wz / |u|), where b is the
    direction in which the wheel rolls. The wheel also rolls backwards, in the direction b + pi.
    """
    vx, vy, wz = twist
    ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
    speed, bend = math.hypot(ux, uy), wz * wheel.trail
    if speed < _TOLERANCE and abs(bend) < _TOLERANCE:
        return -wz * wheel.lateral_offset
    if abs(bend) > speed + _TOLERANCE:
        return None
    lead = math.asin(max(-1.0, min(1.0, bend / speed)))
    direction = math.atan2(uy, ux) - wheel.heading
    for turn in (direction + lead, direction - lead + math.pi):
        if _within_limits(wheel.steering_sign * turn, steering):
            c, s = math.cos(wheel.heading + turn), math.sin(wheel.heading + turn)
            return c * ux + s * uy - wz * wheel.lateral_offset
    return None


def _within_limits(angle: float, joint: Joint) -> bool:
    """Return whether a joint reaches the angle (rad), or the same angle after full turns."""
    if joint.lower is None or joint.upper is None:
        return True
    turns = math.ceil((joint.lower - _TOLERANCE - angle) / math.tau)
    return angle + turns * math.tau <= joint.upper + _TOLERANCE


def tightest_turn(robot: Robot) -> Center | None:
    """Return the centre of rotation nearest to the origin of ``base_link`` that the wheels allow.

    Returns ``None`` if the wheels allow no turn without slip.
    """
    lines = fixed_rows(robot)
    fixed_count = len(lines)
    joints = {joint.name: joint for joint in robot.joints}
    for wheel in robot.wheels:
        joint = joints.get(wheel.steering_joint or "")
        for limit in (joint.lower, joint.upper) if joint is not None else ():
            if limit is not None:
                angle = wheel.heading + wheel.steering_sign * limit
                c, s = math.cos(angle), math.sin(angle)
                lines.append((-s, c, c * wheel.x + s * wheel.y + wheel.trail))
    candidates = [(0.0, 0.0), *(_nearest_point(line) for line in lines)]
    for i, line in enumerate(lines):
        # All fixed axles must pass through the centre, so the first one is enough.
        if i == 0 or fixed_count == 0:
            candidates += filter(None, (_intersection(line, other) for other in lines[i + 1 :]))
    candidates.sort(key=lambda center: math.hypot(*center))
    for x, y in candidates:
        if roll_speeds(robot, (y, -x, 1.0)) is not None:
            return x, y
    return None


def _nearest_point(line: Row) -> Center:
    """Return the point of an axle nearest to the origin.

    The row (a, b, k) of a wheel is zero for the twist (cy, -cx, 1) if a cy - b cx + k = 0.
    """
    a, b, k = line
    return b * k, -a * k


def _intersection(line: Row, other: Row) -> Center | None:
    """Return the point where two axles meet, or ``None`` for parallel axles."""
    a, b, k = line
    c, d, m = other
    determinant = a * d - b * c
    if abs(determinant) < 1e-9:
        return None
    return (a * m - c * k) / determinant, (b * m - d * k) / determinant


def _product(row: Row, twist: Twist) -> float:
    return float_sum(a * b for a, b in zip(row, twist, strict=True))
