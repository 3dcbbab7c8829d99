"""Reads the expanded elements of URDF and xacro files to descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Pose, Vec3
from thorvaldc.tools.audit.audit_facts import Body, BodyJoint, Description, Fact, SolidShape
from thorvaldc.tools.audit.plugin_facts import plugin_facts, ros2_control_facts
from thorvaldc.tools.audit.xml_document import numbers

_LIMITS = {"lower": "rad", "upper": "rad", "velocity": "rad/s", "effort": "N m"}


def read_urdf_description(
    elements: Sequence[Element], file: str, path: Path, report: Report
) -> Description | None:
    """Returns the robot of the child elements of ``<robot>``, or ``None`` if it has no links."""
    description = Description("URDF", Path(file).name, file, path)
    for element in elements:
        name = element.attributes.get("name", "")
        if element.tag == "link":
            if name in description.bodies:
                _report_twice("link", name, element, description.bodies[name].span, report)
            description.bodies.setdefault(name, _body(element))
        elif element.tag == "joint":
            if name in description.joints:
                _report_twice("joint", name, element, description.joints[name].span, report)
            description.joints.setdefault(name, _joint(element))
        elif element.tag == "ros2_control":
            description.facts += ros2_control_facts(element)
        elif element.tag == "gazebo":
            description.facts += plugin_facts(element)
    if not description.bodies:
        return None
    _check_tree(description, report)
    return description


def _report_twice(what: str, name: str, element: Element, first: Span, report: Report) -> None:
    if first != element.span:
        message = f"{what} `{name}` is defined twice; readers of URDF reject the file"
        report.add("audit-description-broken", message, element.span)


def _check_tree(description: Description, report: Report) -> None:
    """Reports joints whose links do not exist."""
    for joint in description.joints.values():
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link and link not in description.bodies:
                report.add(
                    "audit-description-broken",
                    f"the {role} of joint `{joint.name}` is link `{link}`, which does not exist",
                    joint.span,
                    hint=did_you_mean(link, description.bodies, fixable=False),
                )


def read_pose(owner: Element) -> Pose:
    """Returns the pose of the child ``<origin>``, or the identity."""
    origin = owner.find("origin")
    if origin is None:
        return Pose()
    xyz = numbers(origin.attributes.get("xyz", "0 0 0"), 3) or (0.0, 0.0, 0.0)
    rpy = numbers(origin.attributes.get("rpy", "0 0 0"), 3) or (0.0, 0.0, 0.0)
    return Pose.from_xyz_rpy((xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2]))


def _body(element: Element) -> Body:
    body = Body(element.attributes.get("name", ""), element.span)
    inertial = element.find("inertial")
    if inertial is not None:
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        if mass is not None:
            values = numbers(mass.attributes.get("value"), 1)
            body.mass, body.mass_span = values[0] if values else None, mass.span
        if inertia is not None:
            names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            text = " ".join(inertia.attributes.get(name, "0") for name in names)
            body.inertia, body.inertia_span = numbers(text, 6), inertia.span
    for child in element.children:
        if child.tag in ("visual", "collision"):
            shape = _shape(child)
            if shape is not None:
                body.shapes.append(shape)
    return body


def _shape(owner: Element) -> SolidShape | None:
    geometry = owner.find("geometry")
    if geometry is None or not geometry.children:
        return None
    shape = geometry.children[0]
    attributes, collides, pose = shape.attributes, owner.tag == "collision", read_pose(owner)
    size: tuple[float, ...] | None
    if shape.tag == "box":
        size = numbers(attributes.get("size"), 3)
    elif shape.tag in ("cylinder", "capsule"):
        size = numbers(f"{attributes.get('radius')} {attributes.get('length')}", 2)
    elif shape.tag == "sphere":
        size = numbers(attributes.get("radius"), 1)
    elif shape.tag == "mesh":
        size = numbers(attributes.get("scale", "1 1 1"), 3)
    else:
        return None
    if size is None:
        return None
    return SolidShape(shape.tag, size, pose, collides, shape.span, attributes.get("filename", ""))


def _joint(element: Element) -> BodyJoint:
    def link(tag: str) -> str:
        child = element.find(tag)
        return child.attributes.get("link", "") if child is not None else ""

    kind = element.attributes.get("type", "")
    axis_element = element.find("axis")
    values = numbers(axis_element.attributes.get("xyz") if axis_element else None, 3)
    axis: Vec3 = (values[0], values[1], values[2]) if values else (1.0, 0.0, 0.0)
    name = element.attributes.get("name", "")
    joint = BodyJoint(
        name, kind, link("parent"), link("child"), element.span, read_pose(element), axis
    )
    limit = element.find("limit")
    if limit is not None:
        for quantity, unit in _LIMITS.items():
            if quantity in ("lower", "upper") and kind == "continuous":
                continue
            number = numbers(limit.attributes.get(quantity), 1)
            if number is not None:
                shown = unit if kind != "prismatic" else _LINEAR.get(unit, unit)
                joint.limits[quantity] = Fact(quantity, name, number[0], limit.span, shown)
    return joint


_LINEAR = {"rad": "m", "rad/s": "m/s", "N m": "N"}
