"""Checks that gravity and ground hold every body of a robot, see ``model.statics.standing``."""

from __future__ import annotations

import math

from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.robot import Joint, Robot
from thorvaldc.model.statics.standing import Standing, standing_of
from thorvaldc.model.statics.tip_over import support_of

_LEAN = math.radians(1.0)
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
    if standing.stands:
        _check_lean(robot, standing, report)
        return True
    joints = [robot.joint(name) for name in standing.mechanism]
    names = _listed([_reference(joint) for joint in joints])
    are_sprung = any(joint.stiffness > 0.0 for joint in joints)
    report.add(
        "body-not-held",
        f"nothing holds the robot upright: {names} can turn together, and gravity moves them"
        if len(joints) > 1
        else f"nothing holds the joint {names}: gravity moves it",
        joints[0].span if joints else robot.span,
        labels=[Label(joint.span, "moves too") for joint in joints[1:_MAX_LABELS]],
        hint="use stiffer springs, or lower the masses"
        if are_sprung
        else "couple the joints (`couplings`, such as a differential between two rockers), give "
        "one a `spring`, let a limit (`lower`, `upper`) stop it, or make it `fixed`",
    )
    return False


def _check_lean(robot: Robot, standing: Standing, report: Report) -> None:
    moved = []
    for name, position in standing.positions.items():
        joint = robot.joint(name)
        if abs(position) > (_SHIFT if joint.type == "prismatic" else _LEAN):
            moved.append((joint, position))
    if not moved and standing.tilt <= _LEAN:
        return
    positions = [
        f"{_reference(joint)} at {position * 1000:.3g} mm"
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
