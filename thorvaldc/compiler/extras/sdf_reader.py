"""Converts models in SDF to URDF elements."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.compiler.descriptions.facts import UnreadableFileError
from thorvaldc.compiler.extras.converted_elements import UrdfElements, vector
from thorvaldc.compiler.extras.plugin_facts import numbers
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.model import Pose, Vec3
from thorvaldc.model.spatial import scale

_TRUE, _MODEL = ("true", "1"), "__model__"
_DEFAULT_MOMENTS = {"ixx": "1", "iyy": "1", "izz": "1"}


def sdf_models(root: Element) -> list[SdfModel]:
    """Returns the models with joints in an ``<sdf>`` document; scenery has none."""
    version = numbers(root.attributes.get("version"), 1)
    return [
        SdfModel(model, has_old_axes=version is not None and version[0] < 1.5)
        for model in _models(root)
        if any(child.tag == "joint" for child in model.children)
    ]


def _models(element: Element) -> Iterator[Element]:
    for child in element.children:
        if child.tag == "model":
            yield child
        if child.tag in ("model", "world"):
            yield from _models(child)


def _values(element: Element | None) -> dict[str, str]:
    """Returns the texts of the child elements, which are attributes in URDF."""
    children = element.children if element is not None else ()
    return {child.tag: child.text for child in children if child.text}


class SdfModel:
    """One ``<model>``; poses may be relative to other links, joints and frames.

    The frame of a link lies at its joint, as in URDF.

    - ``named``: links, joints and frames by name.
    - ``frames``: names of frames and sensors.
    - ``has_old_axes``: whether axes are in the frame of the model, as before SDF 1.5.
    """

    def __init__(self, model: Element, *, has_old_axes: bool = False) -> None:
        self.model, self.has_old_axes = model, has_old_axes
        self.links = {self.name(e): e for e in model.children if e.tag == "link"}
        self.joints = [e for e in model.children if e.tag == "joint"]
        frames = {self.name(e): e for e in model.children if e.tag == "frame"}
        self.named = {**frames, **{self.name(e): e for e in self.joints}, **self.links}
        self.frames = {*frames, *(self.name(s) for link in self.links.values()
                                  for s in link.children if s.tag == "sensor")}  # fmt: skip
        self.anchors: dict[str, Vec3] = {}
        for joint in self.joints:
            child = self.named.get(self.carrier(_values(joint).get("child", "")))
            if child is not None:
                X_CJ = self.pose(child).inverse() * self.pose(joint)
                self.anchors.setdefault(self.name(child), X_CJ.xyz)

    def name(self, element: Element) -> str:
        return element.attributes.get("name", "")

    def elements(self) -> list[Element]:
        """Returns the links and joints; plug-ins are in ``<gazebo>``, as in URDF."""
        elements = [self.link(e) for e in self.model.children if e.tag == "link"]
        elements += [self.joint(joint) for joint in self.joints]
        plugins = [e for e in self.model.children if e.tag == "plugin"]
        return elements + [UrdfElements(e).element("gazebo", e) for e in plugins]

    def sensors(self) -> list[Element]:
        """Returns the sensors in ``<gazebo>``, each with a link of its own at its pose."""
        elements: list[Element] = []
        taken = {*self.named}
        for name, link in self.links.items():
            X_LS = Pose(scale(-1.0, self.anchors.get(name, (0.0, 0.0, 0.0))))
            for sensor in link.children:
                if sensor.tag == "sensor":
                    urdf, own = UrdfElements(sensor), self.name(sensor)
                    own = f"{name}_{own}" if own in taken else own
                    taken.add(own)
                    pose = X_LS * self.pose_in(link, sensor)
                    elements += [
                        urdf.element("link", name=own),
                        urdf.joint(f"joint of sensor {own}", "fixed", name, own, pose),
                        urdf.element("gazebo", sensor, reference=own),
                    ]
        return elements

    def pose(self, element: Element, depth: int = 0) -> Pose:
        """Returns the pose of a link, joint or frame in the frame of the model."""
        reference, pose = self.stated_pose(element)
        if not reference and element.tag == "joint":
            child = _values(element).get("child", "")
            reference = child if child in self.named else ""
        if not reference and element.tag == "frame":
            reference = self.known(element.attributes.get("attached_to", ""), element)
        if depth > 30:
            raise UnreadableFileError("its poses lead in a circle", element.span)
        is_inner = reference in self.named
        return self.pose(self.named[reference], depth + 1) * pose if is_inner else pose

    def pose_in(self, link: Element, element: Element) -> Pose:
        """Returns the pose of a part of a link in the frame of the link."""
        reference, pose = self.stated_pose(element)
        if not reference or reference == self.name(link):
            return pose
        X_MR = Pose() if reference == _MODEL else self.pose(self.named[reference])
        return self.pose(link).inverse() * X_MR * pose

    def stated_pose(self, element: Element) -> tuple[str, Pose]:
        """Returns what a ``<pose>`` is relative to, or an empty text, and the pose."""
        own = element.find("pose")
        if own is None:
            return "", Pose()
        reference = self.known(own.attributes.get("relative_to", ""), own)
        if not own.text:
            return reference, Pose()
        is_quaternion = own.attributes.get("rotation_format") == "quat_xyzw"
        values = numbers(own.text, 7 if is_quaternion else 6)
        if values is None:
            count = "seven" if is_quaternion else "six"
            raise UnreadableFileError(f"a <pose> has {count} finite numbers", own.span)
        xyz: Vec3 = (values[0], values[1], values[2])
        if is_quaternion:
            x, y, z, w = values[3:]
            if norm := math.hypot(x, y, z, w):
                return reference, Pose(xyz, (w / norm, x / norm, y / norm, z / norm))
            raise UnreadableFileError("a quaternion is not zero", own.span)
        rpy: Vec3 = (values[3], values[4], values[5])
        if own.attributes.get("degrees") in _TRUE:
            rpy = scale(math.radians(1.0), rpy)
        return reference, Pose.from_xyz_rpy(xyz, rpy)

    def known(self, reference: str, place: Element) -> str:
        """Returns a name that a pose refers to, if the model has it."""
        if reference not in ("", _MODEL, *self.named):
            text = f"the model has no link, joint or frame `{reference}`"
            raise UnreadableFileError(text, place.span)
        return reference

    def carrier(self, name: str) -> str:
        """Returns the link that a frame or joint belongs to; another name as it is."""
        for _ in range(30):
            element = self.named.get(name)
            if element is None or element.tag == "link":
                break
            key = element.attributes.get("attached_to", "")
            name = key if element.tag == "frame" else _values(element).get("child", "")
            name = name or next(iter(self.links), "")
        return name

    def link_pose(self, link: str) -> Pose:
        """Returns the pose of the frame of a link at its joint in the frame of the model."""
        pose = self.pose(self.named[link]) if link in self.named else Pose()
        return pose * Pose(self.anchors.get(link, (0.0, 0.0, 0.0)))

    def link(self, element: Element) -> Element:
        name = self.name(element)
        X_LS = Pose(scale(-1.0, self.anchors.get(name, (0.0, 0.0, 0.0))))
        parts: list[Element] = []
        for child in element.children:
            urdf, geometry = UrdfElements(child), child.find("geometry")
            if child.tag == "inertial":
                parts.append(self.inertial(child, X_LS * self.pose_in(element, child)))
            elif child.tag in ("visual", "collision") and geometry is not None:
                shapes = [_shape(shape) for shape in geometry.children]
                origin = urdf.origin(X_LS * self.pose_in(element, child))
                diffuse = _values(child.find("material")).get("diffuse")
                color = urdf.element("color", rgba=diffuse) if diffuse else None
                is_colored = color is not None and child.tag == "visual"
                material = urdf.element("material", color) if is_colored else None
                body = urdf.element("geometry", *shapes)
                parts.append(urdf.element(child.tag, origin, body, material))
        return UrdfElements(element).element("link", *parts, name=name)

    def inertial(self, element: Element, X_LI: Pose) -> Element:
        parts = [UrdfElements(element).origin(X_LI)]
        mass, inertia = element.find("mass"), element.find("inertia")
        if mass is not None and inertia is not None:
            moments = {**_DEFAULT_MOMENTS, **_values(inertia)}
            parts.append(UrdfElements(mass).element("mass", value=mass.text))
            parts.append(UrdfElements(inertia).element("inertia", **moments))
        return UrdfElements(element).element("inertial", *parts)

    def joint(self, element: Element) -> Element:
        values = _values(element)
        parent, child = (self.carrier(values.get(key, "")) for key in ("parent", "child"))
        X_MC, X_MP = self.link_pose(child), self.link_pose(parent)
        axis_element = element.find("axis")
        xyz = axis_element.find("xyz") if axis_element is not None else None
        axis = vector(xyz.text if xyz is not None else None, (0.0, 0.0, 1.0))
        if xyz is not None and numbers(xyz.text, 3) is None:
            raise UnreadableFileError("an axis has three finite numbers", xyz.span)
        frame = xyz.attributes.get("expressed_in", "") if xyz is not None else ""
        if xyz is not None:
            self.known(frame, xyz)
        if self.has_old_axes or _values(axis_element).get("use_parent_model_frame") in _TRUE:
            frame = _MODEL
        X_MA = self.pose(self.named.get(frame, element)) if frame != _MODEL else Pose()
        limit = axis_element.find("limit") if axis_element is not None else None
        stated = {n: v[0] for n, t in _values(limit).items() if (v := numbers(t, 1)) is not None}
        for name in ("velocity", "effort"):
            if stated.get(name, 0.0) < 0.0:
                del stated[name]  # -1 means that there is no limit
        losses = _values(axis_element.find("dynamics") if axis_element is not None else None)
        return UrdfElements(element).joint(
            self.name(element),
            element.attributes.get("type", ""),
            parent,
            child,
            X_MP.inverse() * X_MC,
            X_MC.inverse().rotate(X_MA.rotate(axis)),
            stated,
            limit,
            {name: losses[name] for name in ("damping", "friction") if name in losses},
        )


def _shape(shape: Element) -> Element:
    """Returns a shape of URDF; a capsule becomes a cylinder."""
    values = _values(shape)
    if shape.tag == "mesh":
        values = {"filename": values.get("uri", ""), "scale": values.get("scale", "1 1 1")}
    tag = "cylinder" if shape.tag == "capsule" else shape.tag
    return UrdfElements(shape).element(tag, **values)
