"""Reads the expanded elements of URDF and xacro files to descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Pose
from thorvaldc.tools.audit.audit_facts import BodyJoint, Description
from thorvaldc.tools.audit.description_reader import DescriptionReader
from thorvaldc.tools.audit.plugin_facts import plugin_facts, ros2_control_facts
from thorvaldc.tools.audit.xml_document import vector


def read_urdf_description(
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
