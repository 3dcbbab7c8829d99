"""Checks of the motions that a robot's wheels allow and control.

Notation of Campion, Bastin and d'Andrea-Novel, "Structural properties and classification of
kinematic and dynamic models of wheeled mobile robots" (1996).  A wheel at (x, y) with the heading
angle b rolls without sliding sideways if

    (-sin b, cos b, x cos b + y sin b) . (vx, vy, wz) = 0          (lateral row),

and its motor sets the speed along the heading

    (cos b, sin b, x sin b - y cos b) . (vx, vy, wz) = v           (rolling row).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.compiler.geometry.wheel_geometry import contact_point
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.robot import Robot, Wheel

Row = tuple[float, float, float]


def check_steering_range(robot: Robot, report: Report) -> None:
    """Checks that steered wheels reach every direction, if fixed wheels do not limit them.

    With reversing, half a turn of steering is enough.
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
                hint="give the steering a wider range, or accept that some twists are refused",
            )


def feasible_twists(robot: Robot) -> int:
    """Returns the number of components of the twist that the fixed wheels leave free, 0 to 3."""
    return 3 - _rank(_fixed_rows(robot))


def check_controllable(robot: Robot, report: Report) -> None:
    """Checks that the wheels determine all of the twist (vx, vy, wz) for some steering angles.

    Each wheel that is not a caster gives a lateral row, each driven wheel also a rolling row.
    The rows must have rank 3.
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
    for turn in (0.3, 1.1, 2.0):  # Arbitrary angles (rad): special ones can lower the rank.
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
    return [
        _lateral_row(wheel, wheel.heading)
        for wheel in robot.wheels
        if wheel.steering_joint is None and wheel.swivel_joint is None
    ]


def _cannot_turn(robot: Robot) -> bool:
    """Returns true if the fixed wheels prevent turning: wz depends on their rows."""
    rows = _fixed_rows(robot)
    return _rank([*rows, (0.0, 0.0, 1.0)]) == _rank(rows)


def _lateral_row(wheel: Wheel, angle: float) -> Row:
    x, y = contact_point(wheel)
    c, s = math.cos(angle), math.sin(angle)
    return (-s, c, c * x + s * y)


def _rolling_row(wheel: Wheel, angle: float) -> Row:
    x, y = contact_point(wheel)
    c, s = math.cos(angle), math.sin(angle)
    return (c, s, s * x - c * y)


def _rank(rows: Sequence[Row], tolerance: float = 1e-4) -> int:
    """Computes the rank of a matrix of three columns by Gram-Schmidt.

    ``tolerance`` is the length (m) below which a remainder counts as 0.
    """
    basis: list[Row] = []
    for row in sorted(rows, key=lambda r: -sum(v * v for v in r)):
        remainder = list(row)
        for b in basis:
            projection = sum(r * v for r, v in zip(remainder, b, strict=True))
            remainder = [r - projection * v for r, v in zip(remainder, b, strict=True)]
        length = math.sqrt(sum(r * r for r in remainder))
        if length > tolerance:
            basis.append((remainder[0] / length, remainder[1] / length, remainder[2] / length))
    return len(basis)
