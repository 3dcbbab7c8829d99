"""Checks which twists the wheels of a robot allow, and which twists the motors control.

The module ``model.statics.mobility`` explains the rows.
"""

from __future__ import annotations

import math

from thorvaldc.diagnostics import Label, Report
from thorvaldc.model import Robot
from thorvaldc.model.statics.mobility import (
    cannot_turn,
    feasible_twists,
    lateral_row,
    rank,
    rolling_row,
)


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
    controlled = 0
    # The steering angles (rad) are arbitrary values.  Special steering angles, such as 0, can
    # reduce the rank of the matrix.
    for turn in (0.3, 1.1, 2.0):
        rows = []
        for k, wheel in enumerate(robot.wheels):
            if wheel.swivel_joint is not None:
                continue
            is_steered = wheel.steering_joint is not None
            angle = wheel.heading + (turn * (k + 1) if is_steered else 0.0)
            rows.append(lateral_row(wheel, angle))
            if wheel.driven:
                rows.append(rolling_row(wheel, angle))
        controlled = max(controlled, rank(rows))
    if controlled < 3:
        casters = [wheel for wheel in robot.wheels if wheel.swivel_joint is not None]
        report.add(
            "twist-uncontrolled",
            f"the wheels control only {controlled} of the 3 components of the robot's motion "
            "(forward, sideways, turning)",
            robot.span,
            labels=[Label(wheel.span, "swivels freely") for wheel in casters[:2]],
            hint="replace a swivelling caster by a wheel with a fixed direction (`caster/fixed`), "
            "or drive another wheel",
        )
    elif free == 1 and cannot_turn(robot):
        report.add(
            "skid-steering",
            "the robot can turn only by skidding: its fixed wheels are not on one axle",
            robot.span,
            hint="odometry will be poor; steer some wheels or let them swivel",
        )
