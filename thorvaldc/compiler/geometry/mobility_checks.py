"""Checks which twists the wheels of a robot allow, and which twists the motors control.

The notation follows Campion, Bastin and d'Andrea-Novel, "Structural properties and classification
of kinematic and dynamic models of wheeled mobile robots" (1996).  Condition that a wheel at the
position (x, y) with the heading angle b does not slide sideways when the robot moves with the twist
(vx, vy, wz):

    (-sin b, cos b, x cos b + y sin b) . (vx, vy, wz) = 0          (lateral row).

Condition that a driven wheel rolls with the speed v along the heading:

    (cos b, sin b, x sin b - y cos b) . (vx, vy, wz) = v           (rolling row).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.compiler.geometry.wheel_geometry import contact_point
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.robot import Robot, Wheel

Row = tuple[float, float, float]


def check_steering_range(robot: Robot, report: Report) -> None:
    """Checks that each steered wheel can point in every direction.

    A steering range of half a turn is enough, because a wheel can also roll backwards.  The
    steering range of a robot with fixed wheels is not checked, because the fixed wheels limit the
    directions of motion.
    """
    if feasible_twists(robot) < 3:
        return
    joints = {joint.name: joint for joint in robot.joints}
    for wheel in robot.wheels:
        joint = joints.get(wheel.steering_joint or "")
        if joint is None or joint.lower is None or joint.upper is None:
            continue
        if joint.upper - joint.lower < math.pi - 1e-6:
            report.add(
                "steering-range",
                f"`{wheel.module}` steers over {math.degrees(joint.upper - joint.lower):.1f} deg; "
                "180 deg are needed to reach every direction",
                wheel.span,
                hint="give the steering a wider range; without it, the robot makes the nearest "
                "reachable motion, or stands",
            )


def feasible_twists(robot: Robot) -> int:
    """Returns the number of independent twists that the fixed wheels allow, from 0 to 3."""
    return 3 - _rank(_fixed_rows(robot))


def check_controllable(robot: Robot, report: Report) -> None:
    """Checks that the wheels fully determine the motion of the robot, with suitable steering
    angles.

    Each wheel that is not a caster adds a lateral row to a matrix.  Each driven wheel also adds a
    rolling row to the matrix.  The matrix of all lateral and rolling rows must have the rank 3.
    """
    if not any(wheel.driven for wheel in robot.wheels):
        return
    free = feasible_twists(robot)
    if free == 0:
        report.add(
            "no-free-motion",
            "the wheels that cannot turn block each other: every motion skids",
            robot.span,
            hint="steer some of them, or let them swivel",
        )
        return
    rank = 0
    # The steering angles (rad) are arbitrary values.  Special steering angles, such as 0, can
    # reduce the rank of the matrix.
    for turn in (0.3, 1.1, 2.0):
        rows = []
        for k, wheel in enumerate(robot.wheels):
            if wheel.swivel_joint is not None:
                continue
            is_steered = wheel.steering_joint is not None
            angle = wheel.heading + (turn * (k + 1) if is_steered else 0.0)
            rows.append(_lateral_row(wheel, angle))
            if wheel.driven:
                rows.append(_rolling_row(wheel, angle))
        rank = max(rank, _rank(rows))
    if rank < 3:
        casters = [wheel for wheel in robot.wheels if wheel.swivel_joint is not None]
        report.add(
            "twist-uncontrolled",
            f"the wheels control only {rank} of the 3 components of the robot's motion "
            "(forward, sideways, turning)",
            robot.span,
            labels=[Label(wheel.span, "swivels freely") for wheel in casters[:2]],
            hint="replace a swivelling caster by a wheel with a fixed direction (`caster/fixed`), "
            "or drive another wheel",
        )
    elif free == 1 and _cannot_turn(robot):
        report.add(
            "skid-steering",
            "the robot can turn only by skidding: its fixed wheels are not on one axle",
            robot.span,
            hint="odometry will be poor; steer some wheels or let them swivel",
        )


def _fixed_rows(robot: Robot) -> list[Row]:
    """Returns the lateral rows of all wheels that neither steer nor swivel."""
    return [
        _lateral_row(wheel, wheel.heading)
        for wheel in robot.wheels
        if wheel.steering_joint is None and wheel.swivel_joint is None
    ]


def _cannot_turn(robot: Robot) -> bool:
    """Returns true if the fixed wheels prevent the robot from turning.

    The fixed wheels prevent the robot from turning if the vector (0, 0, 1) is a linear combination
    of the lateral rows.
    """
    rows = _fixed_rows(robot)
    return _rank([*rows, (0.0, 0.0, 1.0)]) == _rank(rows)


def _lateral_row(wheel: Wheel, angle: float) -> Row:
    """Returns the lateral row of a wheel with the heading ``angle`` (rad)."""
    x, y = contact_point(wheel)
    c, s = math.cos(angle), math.sin(angle)
    return (-s, c, c * x + s * y)


def _rolling_row(wheel: Wheel, angle: float) -> Row:
    """Returns the rolling row of a wheel with the heading ``angle`` (rad)."""
    x, y = contact_point(wheel)
    c, s = math.cos(angle), math.sin(angle)
    return (c, s, s * x - c * y)


def _rank(rows: Sequence[Row], tolerance: float = 1e-4) -> int:
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
