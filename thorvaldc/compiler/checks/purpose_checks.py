"""Checks that a robot can do what it is for: drive straight, with its own motors and battery."""

from __future__ import annotations

import math
from dataclasses import replace

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model import Robot
from thorvaldc.model.statics.mobility import feasible_twists, roll_speeds
from thorvaldc.model.stopping import driven_wheels

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
    if not driven or feasible_twists(robot) == 0 or roll_speeds(robot, FORWARDS) is not None:
        return
    turned = [w for w in robot.wheels if roll_speeds(replace(robot, wheels=(w,)), FORWARDS) is None]
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
            if roll_speeds(robot, (math.cos(angle), math.sin(angle), 0.0)) is not None:
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
