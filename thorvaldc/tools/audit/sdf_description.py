"""Reads the models of SDF files to descriptions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Pose, Vec3
from thorvaldc.model.spatial import scale
from thorvaldc.tools.audit.audit_facts import BodyJoint, Description, Fact
from thorvaldc.tools.audit.description_reader import DescriptionReader
from thorvaldc.tools.audit.plugin_facts import plugin_facts
from thorvaldc.tools.audit.xml_document import numbers, vector


def read_sdf_descriptions(
    root: Element, file: str, path: Path, report: Report
) -> list[Description]:
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
                self.read_sensors(child)
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

    def read_sensors(self, link: Element) -> None:
        for sensor in link.children:
            if sensor.tag == "sensor":
                frame = sensor.find("gz_frame_id") or sensor.find("frame_id")
                if frame is not None:
                    subject = f"sensor `{sensor.attributes.get('name', '')}`"
                    fact = Fact("frame", subject, frame.text, frame.span)
                    self.description.facts.append(fact)
                self.description.frames.add(sensor.attributes.get("name", ""))

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
