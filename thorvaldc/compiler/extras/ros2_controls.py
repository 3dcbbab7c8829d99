"""Elements of extras for ros2_control: the servos that they state, and checks of the joints.

The servos of joints stand in ``<ros2_control>`` and ``<transmission>`` elements.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from xml.etree import ElementTree

from thorvaldc.compiler.extras.urdf_elements import call_labels
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Label, Report, Span, did_you_mean
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


# -- checks ------------------------------------------------------------------------

# The controller manager of ROS 2 reads ``<ros2_control>`` elements from the URDF.  If one of them
# is wrong, it starts no hardware at all, not even that of the other elements.

INTERFACES = ("command_interface", "state_interface")


def check_controls(
    controls: Sequence[Element],
    joints: Sequence[Joint],
    own_joints: Mapping[str, Span],
    report: Report,
) -> None:
    """Checks the ``<ros2_control>`` elements of all extras.

    - ``joints``: joints of the extras.
    - ``own_joints``: source span of each joint of the robot itself, by name.
    """
    _Checker(joints, own_joints, report).check(controls)


class _Checker:
    """Checks one element after the other.

    - ``names``: source span of the first element of each name.
    - ``interfaces``: source span of the first joint element that has an interface.
    """

    def __init__(
        self, joints: Sequence[Joint], own_joints: Mapping[str, Span], report: Report
    ) -> None:
        self.joints = {joint.name: joint for joint in joints}
        self.own_joints = own_joints
        self.report = report
        self.names: dict[str, Span] = {}
        self.interfaces: dict[tuple[str, str, str], Span] = {}

    def add(
        self, code: str, message: str, element: Element, hint: str, first: Span | None = None
    ) -> None:
        labels = [Label(first, "first defined here")] if first is not None else []
        labels += call_labels(element)
        self.report.add(code, message, element.span, hint=hint, labels=labels)

    def check(self, controls: Sequence[Element]) -> None:
        for control in controls:
            self.check_system(control)
            in_element: dict[str, Span] = {}
            for element in _children(control, "joint"):
                name = element.attributes.get("name", "").strip()
                if name in in_element:
                    self.report_twice(name, element, in_element[name])
                    continue
                in_element[name] = element.span
                if self.check_joint(name, element, control):
                    self.check_interfaces(name, element)

    def check_system(self, control: Element) -> None:
        """Checks the name of an element, and that it names a plug-in."""
        name = control.attributes.get("name", "").strip()
        hardware = control.find("hardware")
        plugin = hardware.find("plugin") if hardware is not None else None
        for what, is_there in (
            ("attribute `name`", name),
            ("attribute `type`", control.attributes.get("type", "").strip()),
            ("<hardware> with a <plugin>", plugin is not None and plugin.text),
        ):
            if not is_there:
                self.add(
                    "control-incomplete",
                    f"<ros2_control> has no {what}: the controller manager cannot load it",
                    control,
                    'expected <ros2_control name="..." type="system">'
                    "<hardware><plugin>...</plugin></hardware>",
                )
                break
        if not name:
            return
        if name in self.names:
            self.add(
                "control-name-duplicate",
                f"another <ros2_control> has the name `{name}`",
                control,
                "rename it; many macros have a parameter for the name or a prefix",
                self.names[name],
            )
        self.names.setdefault(name, control.span)

    def report_twice(self, name: str, element: Element, first: Span) -> None:
        self.add(
            "control-joint-duplicate",
            f"<ros2_control> defines the joint `{name}` twice",
            element,
            "remove one; one hardware has one entry for a joint, with all its interfaces",
            first,
        )

    def check_joint(self, name: str, element: Element, control: Element) -> bool:
        """Checks that a joint exists, moves and belongs to an extra; returns whether it does."""
        if name in self.own_joints:
            self.add(
                "control-joint-of-robot",
                f"<ros2_control> of an extra defines `{name}`, a joint of the robot itself",
                element,
                "remove it; the files for ros2_control of the robot contain this joint",
                self.own_joints[name],
            )
            return False
        joint = self.joints.get(name)
        if joint is None:
            self.add(
                "control-joint-unknown",
                f"<ros2_control> names the joint `{name}`, which does not exist"
                if name
                else "a <joint> of <ros2_control> has no name",
                element,
                did_you_mean(name, list(self.joints), fixable=False)
                or "the joints of the extras are "
                + (", ".join(f"`{known}`" for known in list(self.joints)[:8]) or "none"),
            )
            return False
        if joint.type == "fixed":
            self.add(
                "control-joint-refused",
                f"<ros2_control> defines the joint `{name}`, which is fixed: the controller "
                "manager refuses the robot",
                element,
                "remove it, or give the joint another type",
                joint.span,
            )
        elif joint.mimic is not None and element.attributes.get("mimic") != "false":
            self.check_mimic(joint, element, control)
        return True

    def check_mimic(self, joint: Joint, element: Element, control: Element) -> None:
        assert joint.mimic is not None
        leader = joint.mimic.joint
        names = [e.attributes.get("name", "").strip() for e in _children(control, "joint")]
        problem = None
        if element.find("command_interface") is not None:
            problem, hint = "has a command interface", "remove its <command_interface>"
        elif leader not in names:
            problem = f"follows `{leader}`, which this element does not define"
            hint = f"define `{leader}` in the same <ros2_control>"
        if problem is not None:
            self.add(
                "control-joint-refused",
                f"the mimic joint `{joint.name}` {problem}: the controller manager of Jazzy and "
                "newer refuses the robot",
                element,
                hint,
                joint.span,
            )

    def check_interfaces(self, name: str, element: Element) -> None:
        """Checks that no other element has one of the interfaces of a joint."""
        for tag in INTERFACES:
            for interface in _children(element, tag):
                key = (tag, name, interface.attributes.get("name", "").strip())
                first = self.interfaces.setdefault(key, element.span)
                if first is not element.span:
                    self.add(
                        "control-joint-duplicate",
                        f"another <ros2_control> has the {tag.replace('_', ' ')} `{name}/{key[2]}`",
                        element,
                        "remove one of them; one hardware has an interface",
                        first,
                    )
                    return


def _children(element: Element, tag: str) -> Iterator[Element]:
    return (child for child in element.children if child.tag == tag)
