"""Reads statements about the robot from plug-ins of Gazebo and from ``<ros2_control>``."""

from __future__ import annotations

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.tools.audit.audit_facts import Fact
from thorvaldc.tools.audit.xml_document import numbers, walk

# Parameters of drive plug-ins: tag -> (kind of the fact, factor to SI).
_GEOMETRY = {
    "wheel_radius": ("wheel radius", 1.0),
    "wheel_diameter": ("wheel radius", 0.5),
    "wheel_separation": ("wheel separation", 1.0),
    "wheelSeparation": ("wheel separation", 1.0),
    "wheelDiameter": ("wheel radius", 0.5),
}
_LEFT = ("left_joint", "leftJoint", "front_left_joint", "back_left_joint", "rear_left_joint")
_RIGHT = ("right_joint", "rightJoint", "front_right_joint", "back_right_joint", "rear_right_joint")
_JOINTS = (*_LEFT, *_RIGHT, "joint_name", "left_steering_joint", "right_steering_joint")
_FRAMES = ("robot_base_frame", "robotBaseFrame", "frame_name", "frameName")


def plugin_facts(element: Element) -> list[Fact]:
    """Returns the statements of all plug-ins in a ``<gazebo>`` or ``<model>`` element."""
    facts: list[Fact] = []
    reference = element.attributes.get("reference")
    if element.tag == "gazebo" and reference:
        facts.append(Fact("gazebo reference", "<gazebo>", reference, element.span))
    for plugin in walk(element):
        if plugin.tag == "plugin":
            facts += _facts_of(plugin)
    return facts


def _facts_of(plugin: Element) -> list[Fact]:
    name = plugin.attributes.get("name") or plugin.attributes.get("filename", "")
    subject = f"plug-in `{name}`"
    facts: list[Fact] = []
    left = tuple(c.text for c in plugin.children if c.tag in _LEFT)
    right = tuple(c.text for c in plugin.children if c.tag in _RIGHT)
    for child in plugin.children:
        if child.tag in _JOINTS:
            facts.append(Fact("joint", subject, child.text, child.span))
        elif child.tag in _FRAMES:
            facts.append(Fact("frame", subject, child.text, child.span))
        elif child.tag in ("publish_odom_tf", "publishOdomTF") and child.text in ("true", "1"):
            frame = plugin.find("odometry_frame") or plugin.find("odometryFrame")
            odom = frame.text.strip("/") if frame is not None else "odom"
            shown = f"{subject} ({child.tag})"
            facts.append(Fact("plug-in transform", shown, True, child.span, "", (odom,)))
        elif child.tag in _GEOMETRY:
            kind, factor = _GEOMETRY[child.tag]
            values = numbers(child.text, 1)
            if values is not None:
                names = (*left, "", *right) if kind == "wheel separation" else (*left, *right)
                facts.append(Fact(kind, subject, values[0] * factor, child.span, "m", names))
    return facts


def ros2_control_facts(element: Element) -> list[Fact]:
    """Returns the joints of a ``<ros2_control>`` element, their limits and node ids."""
    facts: list[Fact] = []
    subject = f'<ros2_control name="{element.attributes.get("name", "")}">'
    for child in element.children:
        name = child.attributes.get("name", "")
        if child.tag == "hardware":
            facts += [
                Fact("joint", subject, parameter.text, parameter.span)
                for parameter in child.children
                if parameter.attributes.get("name", "").endswith("wheel_name")
            ]
        elif child.tag == "joint":
            facts.append(Fact("joint", subject, name, child.span))
            facts += _interface_facts(child, name, subject)
    return facts


def _interface_facts(joint: Element, name: str, subject: str) -> list[Fact]:
    facts: list[Fact] = []
    for child in joint.children:
        interface = child.attributes.get("name", "")
        if child.tag == "param" and interface == "node_id":
            facts.append(Fact("node id", subject, child.text, child.span, "", (name,)))
        if child.tag != "command_interface":
            continue
        for parameter in child.children:
            limit = parameter.attributes.get("name", "")
            values = numbers(parameter.text, 1)
            if values is not None and limit in ("min", "max"):
                kind = f"{interface} {limit}"
                facts.append(Fact(kind, subject, values[0], parameter.span, "", (name,)))
    return facts
