"""Reads URDF and SDF to descriptions of a robot, with the statements of their plug-ins."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar
from xml.parsers import expat

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.model import Pose, Vec3
from thorvaldc.model.spatial import scale
from thorvaldc.tools.audit.audit_facts import (
    Body,
    BodyJoint,
    Description,
    Fact,
    SolidShape,
    UnreadableFileError,
)

# -- XML files, without document types and entities -------------------------------------

MAX_ELEMENTS = 200_000
MAX_DEPTH = 100


class _OpenElement:
    def __init__(self, tag: str, attributes: dict[str, str], span: Span) -> None:
        self.tag = tag
        self.attributes = attributes
        self.span = span
        self.children: list[Element] = []
        self.texts: list[str] = []


def read_xml(data: bytes, display: str, path: Path) -> Element:
    """Returns the root element of an XML document.

    Raises ``UnreadableFileError`` if the text is not XML, has a document type with entities, is
    nested more than ``MAX_DEPTH`` levels deep or has more than ``MAX_ELEMENTS`` elements.
    """
    parser = expat.ParserCreate()
    open_elements = [_OpenElement("", {}, Span(display))]
    count = 0

    def here(length: int = 1) -> Span:
        line, column = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        return Span(display, line, column, line, column + length)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            raise UnreadableFileError(f"it has more than {MAX_ELEMENTS} elements", here())
        if len(open_elements) > MAX_DEPTH:
            raise UnreadableFileError(f"it is nested more than {MAX_DEPTH} levels deep", here())
        open_elements.append(_OpenElement(tag, attributes, here(len(tag) + 1)))

    def end(tag: str) -> None:
        raw = open_elements.pop()
        text = "".join(raw.texts).strip()
        element = Element(raw.tag, raw.attributes, tuple(raw.children), text, raw.span, (), path)
        open_elements[-1].children.append(element)

    def refuse(*_: Any) -> None:
        raise UnreadableFileError("it defines entities", here())

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = lambda text: open_elements[-1].texts.append(text)
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        span = Span(display, error.lineno, error.offset + 1, error.lineno, error.offset + 2)
        text = expat.ErrorString(error.code)
        raise UnreadableFileError(f"line {error.lineno}: {text}", span) from None
    except LookupError as error:  # an encoding that Python does not know
        raise UnreadableFileError(str(error), here()) from None
    return open_elements[0].children[0]


def numbers(text: str | None, count: int) -> tuple[float, ...] | None:
    """Returns the ``count`` numbers of a text, or ``None`` if it does not contain them."""
    if text is None:
        return None
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        return None
    return values if len(values) == count and all(abs(v) < 1e300 for v in values) else None


def vector(text: str | None, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """Returns the vector in a text, or the default if the text does not contain three numbers."""
    values = numbers(text, 3)
    return default if values is None else (values[0], values[1], values[2])


def walk(element: Element) -> list[Element]:
    """Returns an element and all elements in it, in the order of the file."""
    elements = [element]
    for child in element.children:
        elements += walk(child)
    return elements


UNLIMITED = 1e15  # limits of this size mean no limit
# Values of each shape and how many numbers they have together.
_SIZES = {
    "box": (("size",), 3),
    "cylinder": (("radius", "length"), 2),
    "capsule": (("radius", "length"), 2),
    "sphere": (("radius",), 1),
    "ellipsoid": (("radii",), 3),
    "mesh": (("scale",), 3),
}
# Units of each limit: of joints that turn, and of those that slide.
_LIMITS = {
    "lower": ("rad", "m"),
    "upper": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "effort": ("N m", "N"),
}


class DescriptionReader(ABC):
    """Reads links and joints of one robot.

    URDF writes a value as an attribute, SDF as the text of a child element.

    - ``mesh_value``: name of the value that names a mesh file.
    - ``default_moment``: principal moment of inertia (kg m^2) where none is stated.
    """

    mesh_value: ClassVar[str]
    default_moment: ClassVar[str]

    def __init__(self, description: Description, report: Report) -> None:
        self.description = description
        self.report = report

    @abstractmethod
    def value(self, element: Element, name: str) -> tuple[str, Span] | None:
        """Returns the text and the place of a value, or ``None`` if it is not stated."""

    @abstractmethod
    def mass(self, inertial: Element) -> tuple[str, Span] | None:
        """Returns the text and the place of the mass, or ``None`` if it is not stated."""

    @abstractmethod
    def pose(self, element: Element) -> Pose:
        """Returns the pose of a shape in the frame of its link."""

    def text(self, element: Element, name: str, default: str = "") -> str:
        value = self.value(element, name)
        return value[0] if value is not None else default

    def add_body(self, element: Element) -> None:
        body = self._body(element)
        self._report_twice("link", body, self.description.bodies.setdefault(body.name, body))

    def add_joint(self, joint: BodyJoint) -> None:
        self._report_twice("joint", joint, self.description.joints.setdefault(joint.name, joint))

    def _report_twice(self, what: str, part: Body | BodyJoint, first: Body | BodyJoint) -> None:
        if first.span != part.span:  # parts of a macro that is called twice have one place
            self.report.add(
                "audit-description-broken",
                f"{what} `{part.name}` is defined twice; readers of {self.description.format}"
                " reject the file",
                part.span,
            )

    def check_links(self, joint: BodyJoint, known: Collection[str]) -> None:
        """Reports links of a joint that do not exist."""
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link and link not in known:
                self.report.add(
                    "audit-description-broken",
                    f"the {role} of joint `{joint.name}` is link `{link}`, which does not exist",
                    joint.span,
                    hint=did_you_mean(link, known, fixable=False),
                )

    def _body(self, element: Element) -> Body:
        body = Body(element.attributes.get("name", ""), element.span)
        inertial = element.find("inertial")
        if inertial is not None:
            mass, inertia = self.mass(inertial), inertial.find("inertia")
            if mass is not None:
                values = numbers(mass[0], 1)
                body.mass, body.mass_span = values[0] if values else None, mass[1]
            if inertia is not None:
                moments = [
                    self.text(inertia, n, self.default_moment) for n in ("ixx", "iyy", "izz")
                ]
                products = [self.text(inertia, name, "0") for name in ("ixy", "ixz", "iyz")]
                body.inertia = numbers(" ".join(moments + products), 6)
                body.inertia_span = inertia.span
        for child in element.children:
            if child.tag in ("visual", "collision"):
                shape = self._shape(child)
                if shape is not None:
                    body.shapes.append(shape)
        return body

    def _shape(self, owner: Element) -> SolidShape | None:
        geometry = owner.find("geometry")
        if geometry is None or not geometry.children:
            return None
        shape = geometry.children[0]
        names, count = _SIZES.get(shape.tag, ((), 0))
        default = "1 1 1" if shape.tag == "mesh" else ""
        size = numbers(" ".join(self.text(shape, name, default) for name in names), count)
        if not size:
            return None
        mesh = self.text(shape, self.mesh_value) if shape.tag == "mesh" else ""
        collides = owner.tag == "collision"
        return SolidShape(shape.tag, size, self.pose(owner), collides, shape.span, mesh)

    def read_limits(self, joint: BodyJoint, limit: Element | None) -> None:
        """Adds the limits of a joint; a negative speed or effort means no limit."""
        if limit is None:
            return
        for quantity, units in _LIMITS.items():
            is_angle = quantity in ("lower", "upper")
            value = self.value(limit, quantity)
            number = numbers(value[0], 1) if value is not None else None
            if value is None or number is None or (is_angle and joint.kind == "continuous"):
                continue
            if abs(number[0]) < UNLIMITED and (is_angle or number[0] >= 0.0):
                unit = units[joint.kind == "prismatic"]
                joint.limits[quantity] = Fact(quantity, joint.name, number[0], value[1], unit)


# -- plug-ins of Gazebo and ``<ros2_control>`` ------------------------------------------

# Parameters of drive plug-ins: tag -> (kind of the fact, factor to SI).
_GEOMETRY = {
    "wheel_radius": ("wheel radius", 1.0),
    "wheel_diameter": ("wheel radius", 0.5),
    "wheel_separation": ("wheel separation", 1.0),
    "wheelSeparation": ("wheel separation", 1.0),
    "wheelDiameter": ("wheel radius", 0.5),
    "wheelbase": ("wheelbase", 1.0),
    "wheel_base": ("wheelbase", 1.0),
}
_FRONT = ("front_left_joint", "front_right_joint")
_BACK = ("back_left_joint", "back_right_joint", "rear_left_joint", "rear_right_joint")
_LEFT = ("left_joint", "leftJoint", "front_left_joint", "back_left_joint", "rear_left_joint")
_RIGHT = ("right_joint", "rightJoint", "front_right_joint", "back_right_joint", "rear_right_joint")
_SIDES = ("left_steering_joint", "right_steering_joint")
_STEERING = tuple(f"{row}{joint}" for row in ("", "front_", "back_") for joint in _SIDES)
_JOINTS = (*_LEFT, *_RIGHT, *_STEERING, "joint_name")


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
    front = tuple(c.text for c in plugin.children if c.tag in _FRONT)
    back = tuple(c.text for c in plugin.children if c.tag in _BACK)
    joints = {
        "wheel radius": (*left, *right),
        "wheel separation": (*left, "", *right),
        "wheelbase": (*front, "", *back),
    }
    for child in plugin.children:
        if child.tag in _JOINTS:
            facts.append(Fact("joint", subject, child.text, child.span))
        elif child.tag in ("publish_odom_tf", "publishOdomTF") and child.text in ("true", "1"):
            frame = plugin.find("odometry_frame") or plugin.find("odometryFrame")
            odom = frame.text.strip("/") if frame is not None else "odom"
            shown = f"{subject} ({child.tag})"
            facts.append(Fact("plug-in transform", shown, True, child.span, "", (odom,)))
        elif child.tag in _GEOMETRY:
            kind, factor = _GEOMETRY[child.tag]
            values = numbers(child.text, 1)
            if values is not None:
                value = values[0] * factor
                facts.append(Fact(kind, subject, value, child.span, "m", joints[kind]))
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


# -- URDF and expanded xacro files ------------------------------------------------------


def read_urdf(
    elements: Sequence[Element], file: str, path: Path, report: Report
) -> Description | None:
    """Returns the robot of the child elements of ``<robot>``, or ``None`` if it has no links."""
    description = Description("URDF", Path(file).name, file, path)
    reader = _UrdfReader(description, report)
    for element in elements:
        if element.tag == "link":
            reader.add_body(element)
        elif element.tag == "joint":
            reader.add_joint(reader.joint(element))
        elif element.tag == "ros2_control":
            description.facts += ros2_control_facts(element)
        elif element.tag == "gazebo":
            description.facts += plugin_facts(element)
    if not description.bodies:
        return None
    for joint in description.joints.values():
        reader.check_links(joint, description.bodies)
    return description


class _UrdfReader(DescriptionReader):
    mesh_value = "filename"
    default_moment = "0"

    def value(self, element: Element, name: str) -> tuple[str, Span] | None:
        text = element.attributes.get(name)
        return None if text is None else (text, element.span)

    def mass(self, inertial: Element) -> tuple[str, Span] | None:
        mass = inertial.find("mass")
        return None if mass is None else (self.text(mass, "value"), mass.span)

    def pose(self, element: Element) -> Pose:
        origin = element.find("origin")
        if origin is None:
            return Pose()
        return Pose.from_xyz_rpy(vector(self.text(origin, "xyz")), vector(self.text(origin, "rpy")))

    def joint(self, element: Element) -> BodyJoint:
        name, kind = self.text(element, "name"), self.text(element, "type")
        parent, child, axis = map(element.find, ("parent", "child", "axis"))
        joint = BodyJoint(
            name,
            kind,
            self.text(parent, "link") if parent else "",
            self.text(child, "link") if child else "",
            element.span,
            self.pose(element),
            vector(self.text(axis, "xyz") if axis else "", (1.0, 0.0, 0.0)),
        )
        self.read_limits(joint, element.find("limit"))
        return joint


# -- SDF --------------------------------------------------------------------------------


def read_sdf(root: Element, file: str, path: Path, report: Report) -> list[Description]:
    """Returns the models with joints in an ``<sdf>`` document; scenery has none."""
    descriptions: list[Description] = []
    for model in _models(root):
        if not any(child.tag == "joint" for child in model.children):
            continue
        name = model.attributes.get("name", Path(file).name)
        description = Description("SDF", name, file, path)
        _SdfReader(model, description, report).read()
        descriptions.append(description)
    return descriptions


def _models(element: Element) -> Iterator[Element]:
    for child in element.children:
        if child.tag == "model":
            yield child
        if child.tag in ("model", "world"):
            yield from _models(child)


class _SdfReader(DescriptionReader):
    """Reads one ``<model>``; poses may be relative to other links, joints and frames."""

    mesh_value = "uri"
    default_moment = "1"

    def __init__(self, model: Element, description: Description, report: Report) -> None:
        super().__init__(description, report)
        self.model = model
        self.named = {
            child.attributes.get("name", ""): child
            for child in model.children
            if child.tag in ("link", "joint", "frame")
        }

    def read(self) -> None:
        description = self.description
        for child in self.model.children:
            if child.tag == "link":
                self.add_body(child)
                sensors = (inner for inner in child.children if inner.tag == "sensor")
                description.frames.update(s.attributes.get("name", "") for s in sensors)
            elif child.tag == "frame":
                description.frames.add(child.attributes.get("name", ""))
            elif child.tag == "plugin":
                description.facts += plugin_facts(child)
        for child in self.model.children:
            if child.tag == "joint":
                joint = self.joint(child)
                # Links of models inside of this one are not read.
                nested = [link for link in (joint.parent, joint.child) if "::" in link]
                self.check_links(joint, [*self.named, "world", *nested])
                if joint.child in self.named:
                    self.add_joint(joint)

    def value(self, element: Element, name: str) -> tuple[str, Span] | None:
        child = element.find(name)
        return (child.text, child.span) if child is not None and child.text else None

    def mass(self, inertial: Element) -> tuple[str, Span] | None:
        return self.value(inertial, "mass")

    def pose(self, element: Element, depth: int = 0) -> Pose:
        """Returns the pose of a link, joint or frame in the frame of the model."""
        own = element.find("pose")
        attributes = own.attributes if own is not None else {}
        values = numbers(own.text, 6) if own is not None else None
        pose = Pose()
        if values is not None:
            rpy: Vec3 = (values[3], values[4], values[5])
            if attributes.get("degrees") == "true":
                rpy = scale(math.radians(1.0), rpy)
            pose = Pose.from_xyz_rpy((values[0], values[1], values[2]), rpy)
        reference = attributes.get("relative_to", "")
        if not reference and element.tag == "joint":
            reference = self.text(element, "child")
        if not reference and element.tag == "frame":
            reference = element.attributes.get("attached_to", "")
        if reference in self.named and depth < 30:
            return self.pose(self.named[reference], depth + 1) * pose
        return pose

    def joint(self, element: Element) -> BodyJoint:
        name, kind = element.attributes.get("name", ""), element.attributes.get("type", "")
        parent, child = self.text(element, "parent"), self.text(element, "child")
        X_MC, X_MP = (
            self.pose(self.named[link]) if link in self.named else Pose()
            for link in (child, parent)
        )
        X_CJ = X_MC.inverse() * self.pose(element)
        axis_element = element.find("axis")
        xyz = axis_element.find("xyz") if axis_element is not None else None
        axis = vector(xyz.text if xyz is not None else None, (0.0, 0.0, 1.0))
        expressed_in = xyz.attributes.get("expressed_in", "") if xyz is not None else ""
        if expressed_in == "__model__":
            axis = X_MC.inverse().rotate(axis)
        elif expressed_in in self.named:
            axis = X_MC.inverse().rotate(self.pose(self.named[expressed_in]).rotate(axis))
        else:
            axis = X_CJ.rotate(axis)
        joint = BodyJoint(
            name, kind, parent, child, element.span, X_MP.inverse() * X_MC, axis, anchor=X_CJ.xyz
        )
        self.read_limits(joint, axis_element.find("limit") if axis_element is not None else None)
        return joint
