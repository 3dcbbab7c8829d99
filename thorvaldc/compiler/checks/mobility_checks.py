"""Checks how a robot can move: free twists, controlled twists, bodies that nothing holds, purpose.

The module ``model.statics.mobility`` explains the rows of twists, ``model.statics.standing`` how
gravity and ground hold the bodies of a robot.
"""

from __future__ import annotations

import math
from dataclasses import replace

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, millimetres
from thorvaldc.model import Joint, Robot
from thorvaldc.model.statics import mobility
from thorvaldc.model.statics.standing import Standing, standing_of
from thorvaldc.model.statics.tip_over import support_of
from thorvaldc.model.stopping import driven_wheels


def check_steering_range(robot: Robot, report: Report) -> None:
    """Checks that each steered wheel can point in every direction.

    A steering range of half a turn is enough, because a wheel can also roll backwards.  The
    steering range of a robot with fixed wheels is not checked, because the fixed wheels limit the
    directions of motion.
    """
    if mobility.feasible_twists(robot) < 3:
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
    free = mobility.feasible_twists(robot)
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
            rows.append(mobility.lateral_row(wheel, angle))
            if wheel.driven:
                rows.append(mobility.rolling_row(wheel, angle))
        controlled = max(controlled, mobility.rank(rows))
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
    elif free == 1 and mobility.cannot_turn(robot):
        report.add(
            "skid-steering",
            "the robot can turn only by skidding: its fixed wheels are not on one axle",
            robot.span,
            hint="odometry will be poor; steer some wheels or let them swivel",
        )


# -- what gravity and ground hold --------------------------------------------------------

_LEAN = math.radians(1.0)
_LARGEST_LEAN = math.radians(10.1)
"""A robot that leans further before limits stop it cannot be said to stand."""
_SHIFT = 0.01  # m
_MAX_LABELS = 4


def check_bodies_held(robot: Robot, report: Report) -> bool:
    """Reports joints that form a mechanism, and a robot that leans at rest.

    Returns whether the robot stands, so that its wheel loads exist.
    """
    if not support_of(robot).stands:
        return True  # `unstable` has been reported
    standing = standing_of(robot)
    if standing is None:
        return True
    falls = not standing.stands or standing.tilt > _LARGEST_LEAN
    if falls:
        _report_mechanism(robot, standing, report)
    else:
        _check_lean(robot, standing, report)
    return not falls


def _report_mechanism(robot: Robot, standing: Standing, report: Report) -> None:
    names = standing.mechanism or tuple(
        name
        for name, position in standing.positions.items()
        if abs(position) > 0.1 * max(map(abs, standing.positions.values()))
    )
    joints = [robot.joint(name) for name in names]
    listed = _listed([_reference(joint) for joint in joints])
    if standing.stands:
        degrees = math.degrees(standing.tilt)
        message = f"the robot leans by {degrees:.1f} deg before limits stop it: nothing else holds"
        message += f" {listed}"
    elif len(joints) > 1:
        message = f"nothing holds the robot upright: {listed} can move together, and gravity moves"
        message += " them"
    else:
        message = f"nothing holds {listed}: gravity moves it"
    are_sprung = any(joint.stiffness > 0.0 for joint in joints)
    report.add(
        "body-not-held",
        message,
        joints[0].span if joints else robot.span,
        labels=[Label(joint.span, "moves too") for joint in joints[1:_MAX_LABELS]],
        hint="use stiffer springs, or lower the masses"
        if are_sprung
        else "couple the joints (`couplings`, such as a differential between two rockers), give "
        "one a `spring`, stop it by near limits (`lower`, `upper`), or make it `fixed`",
    )


def _check_lean(robot: Robot, standing: Standing, report: Report) -> None:
    moved = []
    for name, position in standing.positions.items():
        joint = robot.joint(name)
        if abs(position) > (_SHIFT if joint.type == "prismatic" else _LEAN):
            moved.append((joint, position))
    if not moved and standing.tilt <= _LEAN:
        return
    positions = [
        f"{_reference(joint)} at {millimetres(position)}"
        if joint.type == "prismatic"
        else f"{_reference(joint)} at {math.degrees(position):.1f} deg"
        for joint, position in moved[:_MAX_LABELS]
    ]
    report.add(
        "leans-on-limits",
        f"at rest, the robot leans by {math.degrees(standing.tilt):.1f} deg, with "
        f"{_listed(positions)}; its other numbers hold with all joints at 0",
        moved[0][0].span if moved else robot.span,
        labels=[Label(joint.span, "moves too") for joint, _ in moved[1:_MAX_LABELS]],
        hint="couple the joints, give them springs, or move the masses so that the robot rests "
        "with its joints at 0",
    )


def _reference(joint: Joint) -> str:
    """Returns the name of a joint as robot documents refer to it, such as `left.pivot`."""
    prefix = joint.module.replace(".", "_") + "_"
    return f"`{joint.module}.{joint.name.removeprefix(prefix)}`"


def _listed(texts: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(texts[:-1]), *texts[-1:])))


# -- what a robot is for: to drive straight, with its own motors and battery -------------

FORWARDS = (1.0, 0.0, 0.0)


def check_purpose(robot: Robot, document: Node, report: Report) -> None:
    """Runs the checks of this module and adds the diagnostics to the report."""
    check_straight_line(robot, report)
    check_motors_turn_wheels(robot, report)
    check_battery(robot, document, report)


def check_straight_line(robot: Robot, report: Report) -> None:
    """Checks that the wheels of a driven robot roll straight ahead.

    A robot whose wheels block each other is left out; it is an error already.
    """
    driven = any(wheel.driven for wheel in robot.wheels)
    if (
        not driven
        or mobility.feasible_twists(robot) == 0
        or mobility.roll_speeds(robot, FORWARDS) is not None
    ):
        return
    turned = [
        w
        for w in robot.wheels
        if mobility.roll_speeds(replace(robot, wheels=(w,)), FORWARDS) is None
    ]
    wheel = turned[0]
    # A wheel also rolls backwards, so its axis is at most 90 deg off.
    angle = math.remainder(wheel.heading, math.pi)
    direction = f"at {math.degrees(angle):.1f} deg to straight ahead"
    other = _straight_line(robot)
    report.add(
        "no-straight-line",
        f"`{wheel.module}` rolls {direction}: "
        + (
            "the robot cannot drive along any straight line"
            if other is None
            else f"the robot drives straight only at {math.degrees(other):.1f} deg to it"
        ),
        wheel.span,
        labels=[
            Label(w.span, "also turned" if w in turned else "rolls straight ahead")
            for w in robot.wheels
            if w is not wheel and w.swivel_joint is None and w.steering_joint is None
        ][:2],
        hint="turn its mount so that it rolls along x, or steer it over a wider range",
    )


def _straight_line(robot: Robot) -> float | None:
    """Returns the direction (rad) of a straight line that all wheels allow, or ``None``.

    A fixed wheel allows one direction, and a steered one an interval of directions.  If the
    intersection of these sets is not empty, it contains the direction of a fixed wheel or the end
    of an interval.
    """
    joints = {joint.name: joint for joint in robot.joints}
    for wheel in robot.wheels:
        joint = joints.get(wheel.steering_joint or "")
        turns = (joint.lower or 0.0, joint.upper or 0.0) if joint is not None else (0.0,)
        for turn in turns:
            angle = math.remainder(wheel.heading + wheel.steering_sign * turn, math.pi)
            if mobility.roll_speeds(robot, (math.cos(angle), math.sin(angle), 0.0)) is not None:
                return angle
    return None


def check_motors_turn_wheels(robot: Robot, report: Report) -> None:
    """Checks that motors on joints for driving and steering wheels drive and steer a wheel.

    Motors on other joints, such as those of a tool, need no wheel.
    """
    of_wheels = {name for w in robot.wheels for name in (w.spin_joint, w.steering_joint)}
    verbs = {"propulsion": "drives", "steering": "steers"}
    for motor in robot.actuators:
        verb = verbs.get(robot.joint(motor.joint).role)
        if verb is not None and motor.joint not in of_wheels:
            report.add(
                "motor-without-wheel",
                f"the motor `{motor.name}` {verb} no wheel",
                motor.span,
                hint="mount a wheel on its module, or leave the module out",
            )


def check_battery(robot: Robot, document: Node, report: Report) -> None:
    """Checks that a robot whose drive motors have controllers has a battery.

    A robot without controllers has no electronics at all, which `robot-without-controller` reports.
    """
    driven = any(m.node is not None for _, m in driven_wheels(robot.wheels, robot.actuators))
    if not driven or any(battery.node is not None for battery in robot.batteries):
        return
    modules = document.get("modules")
    empty = robot.batteries[0].span if robot.batteries else None
    report.add(
        "battery-missing",
        "the robot has drive motors and no battery: its weight, wheel loads and energy leave it out"
        if empty is None
        else "the robot has drive motors, and no battery is in its enclosure",
        empty or (modules.where if modules is not None else robot.span),
        hint="mount a `battery/enclosure`, or a module of your own with a section `battery`; "
        "accept the warning for a robot on a cable",
    )
