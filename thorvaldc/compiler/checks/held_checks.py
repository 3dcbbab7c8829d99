"""Checks that gravity and ground hold every body of a robot, see ``model.statics.standing``."""

from __future__ import annotations

import math

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.plain_numbers import millimetres
from thorvaldc.model import Joint, Robot
from thorvaldc.model.statics.standing import Standing, standing_of
from thorvaldc.model.statics.tip_over import support_of

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
