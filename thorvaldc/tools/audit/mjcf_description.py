"""Converts MJCF files to URDF elements: bodies, joints with their defaults, geoms.

Numbers that MuJoCo computes, such as masses from densities, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from thorvaldc.compiler.descriptions.facts import FileDescription
from thorvaldc.compiler.extras.plugin_facts import numbers
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report
from thorvaldc.model import Pose, Vec3, spatial
from thorvaldc.tools.audit.descriptions import UrdfElements, read_description, vector

Include = Callable[[str, Element], Element | None]
MAX_INCLUDES = 50


def read_mjcf_description(
    root: Element, file: str, path: Path, include: Include, report: Report
) -> FileDescription | None:
    """Returns the robot of a ``<mujoco>`` document, or ``None`` if it has no bodies with joints.

    - ``include``: function that returns the root element of an included file, or ``None``.
    """
    name = root.attributes.get("model", Path(file).name)
    description = FileDescription(format="MJCF", name=name, file=file, path=path)
    sections = _with_includes(root, include, [0]).children
    reader = _Reader()
    for section in sections:
        if section.tag == "compiler":
            reader.read_compiler(section)
        elif section.tag == "default":
            reader.read_defaults(section, "main", {})
    for section in sections:
        if section.tag == "worldbody":
            reader.children(section, "", "main", Pose())
    read_description(description, reader.elements, report)
    description.frames = reader.frames
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
    """Collects the URDF elements of the bodies; the frame of a body lies at its first joint."""

    def __init__(self) -> None:
        self.elements: list[Element] = []
        self.frames: set[str] = set()
        self.angle = math.pi / 180.0
        self.sequence = "xyz"
        self.defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}

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
        return {**values.get(element.tag, {}), **element.attributes}

    def pose(self, attributes: dict[str, str]) -> Pose:
        position = vector(attributes.get("pos"))
        quat = numbers(attributes.get("quat"), 4)
        if quat is not None and any(quat):
            return Pose(position, spatial.quat_normalize((quat[0], quat[1], quat[2], quat[3])))
        rotation = (1.0, 0.0, 0.0, 0.0)
        euler = numbers(attributes.get("euler"), 3) or ()
        for letter, value in zip(self.sequence, euler, strict=False):
            turn = spatial.quat_from_axis_angle(
                _AXES.get(letter.lower(), (1.0, 0.0, 0.0)), value * self.angle
            )
            # Small letters are axes that turn with the frame.
            pair = (rotation, turn) if letter.islower() else (turn, rotation)
            rotation = spatial.quat_multiply(*pair)
        return Pose(position, spatial.quat_normalize(rotation))

    def children(
        self, element: Element, owner: str, class_name: str, offset: Pose
    ) -> list[Element]:
        """Reads the elements in a body, or in a ``<frame>`` at the pose ``offset`` in the body.

        Returns the URDF elements of the link; those of the bodies inside are collected.
        """
        class_name = element.attributes.get("childclass", class_name)
        parts: list[Element] = []
        for child in element.children:
            if child.tag == "body":
                self.body(child, owner, class_name, offset)
            elif child.tag == "frame":
                inner = offset * self.pose(child.attributes)
                parts += self.children(child, owner, class_name, inner)
            elif child.tag == "geom":
                parts += self.geom(child, class_name, offset)
            elif child.tag in ("site", "camera"):
                self.frames.add(child.attributes.get("name", ""))
            elif child.tag == "inertial":
                parts += _inertial(child)
        return parts

    def body(self, element: Element, parent: str, class_name: str, offset: Pose) -> None:
        name = element.attributes.get("name") or f"body at {_place(element)}"
        class_name = element.attributes.get("childclass", class_name)
        joints = [
            (child, self.attributes(child, class_name))
            for child in element.children
            if child.tag in ("joint", "freejoint")
        ]
        anchor = Pose(vector(joints[0][1].get("pos"))) if joints else Pose()
        pose = offset * self.pose(element.attributes) * anchor
        for index, (child, attributes) in enumerate(joints):
            # With several joints, the first connects the body; the others get places of their own.
            self.joint(child, attributes, parent if index == 0 else "", name, pose)
        if not joints and parent:
            fixed = f"fixed joint of {name}"
            self.elements.append(UrdfElements(element).joint(fixed, "fixed", parent, name, pose))
        link = len(self.elements)
        parts = self.children(element, name, class_name, anchor.inverse())
        self.elements.insert(link, UrdfElements(element).element("link", *parts, name=name))

    def joint(
        self, element: Element, attributes: dict[str, str], parent: str, child: str, pose: Pose
    ) -> None:
        kind = "free" if element.tag == "freejoint" else attributes.get("type", "hinge")
        name = element.attributes.get("name") or f"joint at {_place(element)}"
        limits = numbers(attributes.get("range"), 2) or ()
        if attributes.get("limited", "auto") == "false":
            limits = ()
        factor = self.angle if kind == "hinge" else 1.0
        axis = vector(attributes.get("axis"), (0.0, 0.0, 1.0))
        joint = UrdfElements(element).joint(
            *(name, _KINDS.get(kind, kind), parent or WORLD, child, pose, axis),
            [factor * limit for limit in limits],
        )
        self.elements.append(joint)

    def geom(self, element: Element, class_name: str, offset: Pose) -> list[Element]:
        """Returns the shape of a geom; a capsule and a tyre become cylinders."""
        attributes = self.attributes(element, class_name)
        kind = attributes.get("type", "mesh" if "mesh" in attributes else "sphere")
        words = attributes.get("size", "").split()
        size = numbers(" ".join(words), len(words)) or ()
        pose = self.pose(attributes)
        ends = numbers(attributes.get("fromto"), 6)
        if ends is not None and size:
            start, end = (ends[0], ends[1], ends[2]), (ends[3], ends[4], ends[5])
            along = spatial.sub(end, start)
            if spatial.norm(along) > 0.0:
                middle = spatial.scale(0.5, spatial.add(start, end))
                pose = Pose(middle, spatial.quat_from_z_to(_unit(along)))
                size = (size[0], spatial.norm(along) / 2.0)
        values: dict[str, str] = {}
        if kind == "box" and len(size) == 3:
            values = {"size": " ".join(repr(2.0 * edge) for edge in size)}
        elif kind in ("cylinder", "capsule") and len(size) >= 2:
            kind, values = "cylinder", {"radius": repr(size[0]), "length": repr(2.0 * size[1])}
        elif kind == "sphere" and size:
            values = {"radius": repr(size[0])}
        elif kind == "ellipsoid" and len(size) == 3 and math.isclose(size[0], size[1]):
            kind, values = "cylinder", {"radius": repr(size[0]), "length": repr(2.0 * size[2])}
        elif kind in ("mesh", "ellipsoid"):
            kind, values = "mesh", {"filename": attributes.get("mesh", kind)}
        else:
            return []
        collides = any(attributes.get(name, "1") != "0" for name in ("contype", "conaffinity"))
        urdf = UrdfElements(element)
        geometry = urdf.element("geometry", urdf.element(kind, **values))
        tag = "collision" if collides else "visual"
        return [urdf.element(tag, urdf.origin(offset * pose), geometry)]


WORLD = "world"
_AXES: dict[str, Vec3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_KINDS = {"hinge": "revolute", "slide": "prismatic", "free": "floating"}
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _inertial(element: Element) -> list[Element]:
    """Returns the mass and the inertia, if both are stated."""
    inertia = element.attributes.get("diaginertia", element.attributes.get("fullinertia", ""))
    mass, urdf = element.attributes.get("mass"), UrdfElements(element)
    if mass is None or not inertia:
        return []
    moments = dict(zip(_MOMENTS, inertia.split(), strict=False))
    parts = (urdf.element("mass", value=mass), urdf.element("inertia", **moments))
    return [urdf.element("inertial", *parts)]


def _place(element: Element) -> str:
    return f"{element.span.file}, line {element.span.line}, column {element.span.column}"


def _unit(a: Vec3) -> Vec3:
    return spatial.scale(1.0 / spatial.norm(a), a)
