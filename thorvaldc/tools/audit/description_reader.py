"""What the readers of URDF and SDF have in common: bodies, shapes, limits and names of links."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from typing import ClassVar

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Pose
from thorvaldc.tools.audit.audit_facts import Body, BodyJoint, Description, Fact, SolidShape
from thorvaldc.tools.audit.xml_document import numbers

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
