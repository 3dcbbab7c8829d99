"""The elements that only the URDF contains: those of extras, and mimic joints."""

from __future__ import annotations

from collections.abc import Iterator

from thorvaldc.backends.xml_writer import parse
from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.model import Robot

SERVO_ELEMENTS = ("ros2_control", "transmission")
"""Elements from which the compiler reads the servos of joints."""


def urdf_only_elements(robot: Robot, target: str, *, mimics: bool = False) -> Iterator[Diagnostic]:
    """Yield a diagnostic if a format leaves out elements of the extras or couplings of joints.

    - ``target``: name of the format.
    - ``mimics``: true for a format without mimic joints.
    """
    tags = [parse(text).tag for text in robot.urdf_extensions]
    if robot.joint_servos:  # read from these elements
        tags = [tag for tag in tags if tag not in SERVO_ELEMENTS]
    if mimics:
        tags += ["mimic" for joint in robot.joints if joint.mimic is not None]
    if tags:
        yield Diagnostic(
            CODES["urdf-only-element"],
            f"{target} has no elements for these parts of the robot: "
            + ", ".join(f"{tags.count(tag)} x <{tag}>" for tag in dict.fromkeys(tags)),
            robot.span,
            "the URDF has them",
        )
