"""Reads the servos of joints from ``<ros2_control>`` and ``<transmission>`` elements of extras."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from xml.etree import ElementTree

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report
from thorvaldc.model import Joint, JointServo

POSITION, VELOCITY = "position", "velocity"


def stated_servos(extensions: Iterable[Element]) -> Iterator[JointServo]:
    """Returns the servos that the URDF extensions of one xacro file state, in their order.

    A joint of ``<ros2_control>`` has a servo if it has a command interface, a joint of
    ``<transmission>`` always.  The servo commands the velocity if velocity is stated and position
    is not.  A joint with the interface ``effort`` alone gets a position servo, which stands for its
    controller.
    """
    for extension in extensions:
        try:
            root = ElementTree.fromstring(extension.xml)
        except ElementTree.ParseError:
            continue  # a prefix without a definition: no file of ROS contains one here
        for joint in root.iter("joint"):
            name = joint.get("name", "").strip()
            if root.tag == "ros2_control":
                interfaces = {e.get("name", "") for e in joint.iter("command_interface")}
            elif root.tag == "transmission":
                # ROS 1 states it in the joint, older files in the actuator.
                texts = (e.text or "" for e in root.iter("hardwareInterface"))
                interfaces = {_interface(text) for text in texts} or {POSITION}
            else:
                continue
            if name and interfaces:
                is_velocity = VELOCITY in interfaces and POSITION not in interfaces
                interface = VELOCITY if is_velocity else POSITION
                yield JointServo(name, interface, _initial(joint), extension.span)


def _interface(text: str) -> str:
    """Returns the interface of ``<hardwareInterface>``, such as ``EffortJointInterface``."""
    name = text.strip().rpartition("/")[2].lower()
    return next((i for i in (POSITION, VELOCITY) if name.startswith(i)), "effort")


def _initial(joint: ElementTree.Element) -> float:
    """Returns the parameter ``initial_value`` of the position, or NaN without one."""
    for interface in joint.iter():
        if interface.tag.endswith("_interface") and interface.get("name") == POSITION:
            for param in interface.iter("param"):
                if param.get("name") == "initial_value":
                    try:
                        return float(param.text or "")
                    except ValueError:
                        return math.nan
    return math.nan


def servos_of(
    stated: Sequence[JointServo], joints: Sequence[Joint], report: Report
) -> tuple[JointServo, ...]:
    """Returns one servo for each driven joint of the extras, in the order of the joints.

    Fixed joints, mimic joints and joints of the robot itself get none.  A joint that no element
    gives an initial position starts at 0, or at the limit that is nearest to 0.
    """
    by_joint: dict[str, JointServo] = {}
    for servo in stated:
        known = by_joint.setdefault(servo.joint, servo)
        if math.isnan(known.initial):
            by_joint[servo.joint] = replace(known, initial=servo.initial)
    return tuple(
        replace(by_joint[joint.name], initial=_start(joint, by_joint, report))
        for joint in joints
        if joint.name in by_joint and joint.type != "fixed" and joint.mimic is None
    )


def _start(joint: Joint, servos: Mapping[str, JointServo], report: Report) -> float:
    servo = servos[joint.name]
    low = -math.inf if joint.lower is None else joint.lower
    high = math.inf if joint.upper is None else joint.upper
    stated = servo.initial if math.isfinite(servo.initial) else 0.0
    start = min(max(stated, low), high)
    if start != stated and math.isfinite(servo.initial):
        report.add(
            "extra-initial-position",
            f"joint `{joint.name}` starts at {stated:g}, outside of its limits {low:g} to "
            f"{high:g}; {start:g} is used",
            servo.span,
            hint="correct the param `initial_value` of the state interface `position`",
        )
    return start
