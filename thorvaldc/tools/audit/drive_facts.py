"""Makes statements about wheels and joints from parameters of controllers and from descriptions."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from thorvaldc.model import Pose, Vec3
from thorvaldc.model.spatial import dot, norm, sub
from thorvaldc.tools.audit.audit_facts import (
    BodyJoint,
    Description,
    Fact,
    ParameterSection,
    SolidShape,
)

LEFT = (
    *("left_wheel_names", "left_wheel_name", "left_wheel"),
    *("front_left_wheel_name", "rear_left_wheel_name"),
    *("front_left_wheel_command_joint_name", "rear_left_wheel_command_joint_name"),
)
RIGHT = tuple(name.replace("left", "right") for name in LEFT)
TRACTION = (
    *("rear_wheels_names", "front_wheels_names", "traction_joints_names"),
    *("traction_joint_name", "wheel_names"),
)
_STEERING = ("steering_joints_names", "steering_joint_name", "front_steering")
_JOINT_LISTS = (*LEFT, *RIGHT, *TRACTION, *_STEERING, "joints", "joint")
_RADIUS = ("wheel_radius", "wheels_radius", "kinematics.wheels_radius", "traction_wheels_radius",
           "front_wheels_radius", "rear_wheels_radius")  # fmt: skip
_SEPARATION = ("wheel_separation", "wheel_separation_y", "traction_track_width")


def controller_facts(section: ParameterSection, known: Collection[str]) -> list[Fact]:
    """Returns what the parameters of a node state about joints and wheels.

    - ``known``: names of the joints of all descriptions.
    """
    facts: list[Fact] = []
    subject = f"`{section.short_name}`"
    for name in _JOINT_LISTS:
        node = section.values.get(name)
        if node is None:
            continue
        items = node.value if isinstance(node.value, tuple) else (node,)
        facts += [
            Fact("joint", subject, joint_of(item.value, known), item.span)
            for item in items
            if isinstance(item.value, str) and is_plain(item.value)
        ]
    left = plain_names(section, LEFT, known)
    right = plain_names(section, RIGHT, known)
    wheels = (*left, *right) or plain_names(section, TRACTION, known)
    for name in _RADIUS:
        node, value = section.values.get(name), section.number(name)
        if node is not None and value is not None and wheels:
            facts.append(Fact("wheel radius", subject, value, node.span, "m", wheels))
    for name in _SEPARATION:
        node, value = section.values.get(name), section.number(name)
        if node is not None and value is not None and left and right:
            names = (*left, "", *right)
            facts.append(Fact("wheel separation", subject, value, node.span, "m", names))
    return facts


def is_plain(name: str) -> bool:
    """Whether a name is written in full, without substitutions such as ``$(var prefix)``."""
    return bool(name) and "$" not in name and "{" not in name and "<" not in name


def joint_of(name: str, known: Collection[str]) -> str:
    """Returns the joint of an interface: that of a chained controller is `controller/joint`."""
    return name if name in known else name.rsplit("/", 1)[-1]


def plain_names(
    section: ParameterSection, parameters: Sequence[str], known: Collection[str]
) -> tuple[str, ...]:
    """Returns the joints in parameters, or no joints if a name contains a substitution."""
    names = [joint_of(text, known) for parameter in parameters for text in section.texts(parameter)]
    return tuple(names) if all(is_plain(name) for name in names) else ()


def wheel_radius(description: Description, joint: BodyJoint) -> Fact | None:
    """Returns the radius of the wheel that a joint turns, from its shapes, or ``None``.

    A wheel is a sphere, or a cylinder whose axis is that of the joint, with its centre on the axis.
    Collision shapes count before shapes for the eye.  The largest wheel of the link counts.
    """
    best: dict[bool, Fact] = {}
    for body, shape in _round_shapes(description, joint):
        radius = shape.size[0]
        fact = best.get(shape.collides)
        if fact is None or radius > fact.value:
            subject = f"joint `{joint.name}`"
            best[shape.collides] = Fact("wheel radius", subject, radius, shape.span, "m", (body,))
    return best.get(True) or best.get(False)


def wheel_center(description: Description, joint: BodyJoint, poses: dict[str, Pose]) -> Vec3 | None:
    """Returns the centre of the wheel that a joint turns in the frame of the root, or ``None``.

    A wheel without shapes is at the joint.  The centre of a wheel that is only a mesh is unknown,
    because the mesh can lie beside the joint.
    """
    link = poses.get(joint.child)
    if link is None:
        return None
    for collides in (True, False):
        for _, shape in _round_shapes(description, joint):
            if shape.collides is collides:
                return link.apply(shape.pose.xyz)
    has_shapes = any(body.shapes for body, _ in description.rigid_part(joint.child))
    return None if has_shapes else link.xyz


def _round_shapes(description: Description, joint: BodyJoint) -> list[tuple[str, SolidShape]]:
    """Returns the wheel shapes of a joint, with poses in the frame of the joint."""
    axis_length = norm(joint.axis)
    if not joint.turns or axis_length == 0.0:
        return []
    axis = tuple(a / axis_length for a in joint.axis)
    shapes: list[tuple[str, SolidShape]] = []
    for body, pose in description.rigid_part(joint.child):
        for shape in body.shapes:
            placed = pose * shape.pose
            direction = placed.rotate((0.0, 0.0, 1.0))
            along = abs(dot(direction, (axis[0], axis[1], axis[2])))
            position = sub(placed.xyz, joint.anchor)
            on_axis = dot(position, (axis[0], axis[1], axis[2]))
            offset = math.sqrt(max(0.0, dot(position, position) - on_axis * on_axis))
            flat = shape.kind in ("cylinder", "tyre", "capsule")
            is_wheel = shape.kind == "sphere" or (flat and along > 0.99)
            if is_wheel and shape.size[0] > 0.0 and offset < 0.1 * shape.size[0]:
                shapes.append((body.name, shape._replace(pose=placed)))
    return shapes
