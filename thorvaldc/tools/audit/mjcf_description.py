"""Reads MJCF files to descriptions: bodies, joints with their defaults, geoms, sites, actuators.

Numbers that MuJoCo computes, such as masses from densities, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report, did_you_mean
from thorvaldc.model import Pose, Vec3, spatial
from thorvaldc.tools.audit.audit_facts import Body, BodyJoint, Description, Fact, SolidShape
from thorvaldc.tools.audit.descriptions import numbers, vector

Include = Callable[[str, Element], Element | None]
MAX_INCLUDES = 50
_JOINT_REFERENCES = ("joint", "joint1", "joint2", "jointinparent")


def read_mjcf_description(
    root: Element, file: str, path: Path, include: Include, report: Report
) -> Description | None:
    """Returns the robot of a ``<mujoco>`` document, or ``None`` if it has no bodies with joints.

    - ``include``: function that returns the root element of an included file, or ``None``.
    """
    reader = _Reader(Description("MJCF", root.attributes.get("model", Path(file).name), file, path))
    sections = _with_includes(root, include, [0]).children
    for section in sections:
        if section.tag == "compiler":
            reader.read_compiler(section)
        elif section.tag == "default":
            reader.read_defaults(section, "main", {})
    for section in sections:
        if section.tag == "worldbody":
            reader.children(section, "", "main", Pose())
    for section in sections if reader.is_complete else ():
        if section.tag in ("actuator", "sensor", "equality", "tendon"):
            reader.read_references(section, report)
    description = reader.description
    return description if description.joints else None


def _with_includes(element: Element, include: Include, count: list[int]) -> Element:
    """Returns an element in which the content of included files replaces ``<include>``."""
    children: list[Element] = []
    for child in element.children:
        if child.tag != "include":
            children.append(_with_includes(child, include, count))
            continue
        count[0] += 1
        inner = include(child.attributes.get("file", ""), child)
        if inner is not None and count[0] <= MAX_INCLUDES:
            children += _with_includes(inner, include, count).children
    return replace(element, children=tuple(children))


class _Reader:
    def __init__(self, description: Description) -> None:
        self.description = description
        self.angle = math.pi / 180.0
        self.sequence = "xyz"
        self.defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        self.is_complete = True

    def read_compiler(self, element: Element) -> None:
        if element.attributes.get("angle") == "radian":
            self.angle = 1.0
        self.sequence = element.attributes.get("eulerseq", self.sequence)

    def read_defaults(self, element: Element, name: str, parent: dict[str, dict[str, str]]) -> None:
        values = {tag: dict(attributes) for tag, attributes in parent.items()}
        for child in element.children:
            if child.tag != "default":
                values.setdefault(child.tag, {}).update(child.attributes)
        name = element.attributes.get("class", name)
        self.defaults[name] = values
        for child in element.children:
            if child.tag == "default":
                self.read_defaults(child, child.attributes.get("class", ""), values)

    def attributes(self, element: Element, class_name: str) -> dict[str, str]:
        """Returns the attributes of an element with those of its default class."""
        chosen = element.attributes.get("class", class_name)
        values = self.defaults.get(chosen, self.defaults["main"])
        tag = "joint" if element.tag == "freejoint" else element.tag
        return {**values.get(tag, {}), **element.attributes}

    # -- bodies -----------------------------------------------------------------------

    def pose(self, attributes: dict[str, str]) -> Pose:
        position = vector(attributes.get("pos"))
        quat = numbers(attributes.get("quat"), 4)
        if quat is not None and any(quat):
            return Pose(position, spatial.quat_normalize((quat[0], quat[1], quat[2], quat[3])))
        axis_angle = numbers(attributes.get("axisangle"), 4)
        if axis_angle is not None and any(axis_angle[:3]):
            axis = (axis_angle[0], axis_angle[1], axis_angle[2])
            return Pose(
                position, spatial.quat_from_axis_angle(_unit(axis), axis_angle[3] * self.angle)
            )
        euler = numbers(attributes.get("euler"), 3)
        if euler is not None:
            rotation = (1.0, 0.0, 0.0, 0.0)
            for letter, value in zip(self.sequence, euler, strict=False):
                axis = _AXES.get(letter.lower(), (1.0, 0.0, 0.0))
                turn = spatial.quat_from_axis_angle(axis, value * self.angle)
                intrinsic = letter.islower()
                rotation = (
                    spatial.quat_multiply(rotation, turn)
                    if intrinsic
                    else spatial.quat_multiply(turn, rotation)
                )
            return Pose(position, spatial.quat_normalize(rotation))
        z_axis = vector(attributes.get("zaxis"))
        if any(z_axis):
            return Pose(position, spatial.quat_from_z_to(_unit(z_axis)))
        return Pose(position)

    def children(self, element: Element, owner: str, class_name: str, offset: Pose) -> None:
        """Reads the elements in a body, or in a ``<frame>`` at the pose ``offset`` in the body."""
        class_name = element.attributes.get("childclass", class_name)
        for child in element.children:
            if child.tag == "body":
                self.body(child, owner, class_name, offset)
            elif child.tag == "frame":
                self.children(child, owner, class_name, offset * self.pose(child.attributes))
            elif child.tag == "geom" and owner:
                self.geom(child, owner, class_name, offset)
            elif child.tag in ("site", "camera"):
                self.description.frames.add(child.attributes.get("name", ""))
            elif child.tag == "inertial" and owner:
                self.inertial(child, owner)
            elif child.tag in ("attach", "replicate", "composite", "flexcomp", "include"):
                self.is_complete = False  # MuJoCo makes bodies with names of their own

    def body(self, element: Element, parent: str, class_name: str, offset: Pose) -> None:
        name = element.attributes.get("name") or f"body at line {element.span.line}"
        self.description.bodies.setdefault(name, Body(name, element.span))
        class_name = element.attributes.get("childclass", class_name)
        pose = offset * self.pose(element.attributes)
        joints = [child for child in element.children if child.tag in ("joint", "freejoint")]
        for index, child in enumerate(joints):
            # With several joints, the first connects the body; the others get places of their own.
            inner = self.joint(child, parent if index == 0 else "", name, class_name, pose)
            self.description.joints.setdefault(inner.name, inner)
        if not joints and parent:
            fixed = f"fixed joint of {name}"
            joint = BodyJoint(fixed, "fixed", parent, name, element.span, pose)
            self.description.joints[fixed] = joint
        self.children(element, name, class_name, Pose())

    def joint(
        self, element: Element, parent: str, child: str, class_name: str, pose: Pose
    ) -> BodyJoint:
        attributes = self.attributes(element, class_name)
        kind = "free" if element.tag == "freejoint" else attributes.get("type", "hinge")
        name = element.attributes.get("name") or f"joint at line {element.span.line}"
        joint = BodyJoint(
            *(name, _KINDS.get(kind, kind), parent, child, element.span, pose),
            axis=vector(attributes.get("axis"), (0.0, 0.0, 1.0)),
            anchor=vector(attributes.get("pos")),
        )
        limits = numbers(attributes.get("range"), 2)
        if limits is not None and attributes.get("limited", "auto") != "false":
            factor, unit = (self.angle, "rad") if kind == "hinge" else (1.0, "m")
            for quantity, value in zip(("lower", "upper"), limits, strict=True):
                fact = Fact(quantity, name, value * factor, element.span, unit)
                joint.limits[quantity] = fact
        return joint

    def inertial(self, element: Element, owner: str) -> None:
        body = self.description.bodies[owner]
        mass = numbers(element.attributes.get("mass"), 1)
        body.mass, body.mass_span = mass[0] if mass else None, element.span
        diagonal = numbers(element.attributes.get("diaginertia"), 3)
        full = numbers(element.attributes.get("fullinertia"), 6)
        if diagonal is not None:
            body.inertia, body.inertia_span = (*diagonal, 0.0, 0.0, 0.0), element.span
        elif full is not None:
            body.inertia, body.inertia_span = full, element.span

    def geom(self, element: Element, owner: str, class_name: str, offset: Pose) -> None:
        attributes = self.attributes(element, class_name)
        kind = attributes.get("type", "mesh" if "mesh" in attributes else "sphere")
        sizes = tuple(float(v) for v in attributes.get("size", "").split() if _is_number(v))
        pose = self.pose(attributes)
        ends = numbers(attributes.get("fromto"), 6)
        if ends is not None and sizes:
            start, end = (ends[0], ends[1], ends[2]), (ends[3], ends[4], ends[5])
            along = spatial.sub(end, start)
            if spatial.norm(along) > 0.0:
                middle = spatial.scale(0.5, spatial.add(start, end))
                pose = Pose(middle, spatial.quat_from_z_to(_unit(along)))
                sizes = (sizes[0], spatial.norm(along) / 2.0)
        collides = (
            attributes.get("contype", "1") != "0" or attributes.get("conaffinity", "1") != "0"
        )
        size: tuple[float, ...]
        mesh = ""
        if kind == "box" and len(sizes) == 3:
            size = tuple(2.0 * s for s in sizes)
        elif kind in ("cylinder", "capsule") and len(sizes) >= 2:
            size = (sizes[0], 2.0 * sizes[1])
        elif kind == "sphere" and sizes:
            size = sizes[:1]
        elif kind == "ellipsoid" and len(sizes) == 3:
            size = sizes
            if math.isclose(size[0], size[1]):  # a tyre: an ellipsoid of revolution
                kind, size = "tyre", (sizes[0], 2.0 * sizes[2])
        elif kind == "mesh":
            size, mesh = (1.0, 1.0, 1.0), attributes.get("mesh", "")
        else:
            return
        shape = SolidShape(kind, size, offset * pose, collides, element.span, mesh)
        self.description.bodies[owner].shapes.append(shape)

    # -- references -------------------------------------------------------------------

    def read_references(self, section: Element, report: Report) -> None:
        """Reports joints of actuators, sensors and constraints that do not exist."""
        known = self.description.joints
        for element in section.children:
            for attribute in _JOINT_REFERENCES:
                name = element.attributes.get(attribute)
                if name is None or name in known:
                    continue
                subject = f"<{element.tag}> `{element.attributes.get('name', '')}`"
                report.add(
                    "audit-joint-unknown",
                    f"{subject} names joint `{name}`, which the file does not have",
                    element.span,
                    hint=did_you_mean(name, known, fixable=False),
                )


_AXES: dict[str, Vec3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_KINDS = {"hinge": "revolute", "slide": "prismatic"}


def _is_number(text: str) -> bool:
    return numbers(text, 1) is not None


def _unit(a: Vec3) -> Vec3:
    return spatial.scale(1.0 / spatial.norm(a), a)
