"""Reads the models of SDF files to descriptions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Pose, Vec3
from thorvaldc.model.spatial import scale
from thorvaldc.tools.audit.audit_facts import Body, BodyJoint, Description, Fact, SolidShape
from thorvaldc.tools.audit.plugin_facts import plugin_facts
from thorvaldc.tools.audit.xml_document import numbers

UNLIMITED = 1e15  # limits of this size mean no limit in SDF


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
        _Model(model, description, report).read()
        descriptions.append(description)
    return descriptions


def _models(element: Element) -> Iterator[Element]:
    for child in element.children:
        if child.tag == "model":
            yield child
        if child.tag in ("model", "world"):
            yield from _models(child)


def _text(element: Element, tag: str) -> str:
    child = element.find(tag)
    return child.text.strip() if child is not None else ""


def _number(element: Element | None, tag: str) -> float | None:
    values = numbers(_text(element, tag), 1) if element is not None else None
    return values[0] if values else None


class _Model:
    """Reads one ``<model>``; poses may be relative to other links, joints and frames."""

    def __init__(self, model: Element, description: Description, report: Report) -> None:
        self.model = model
        self.description = description
        self.report = report
        self.named = {
            child.attributes.get("name", ""): child
            for child in model.children
            if child.tag in ("link", "joint", "frame")
        }

    def read(self) -> None:
        description = self.description
        for child in self.model.children:
            name = child.attributes.get("name", "")
            if child.tag == "link":
                if name in description.bodies:
                    message = f"link `{name}` is defined twice in model `{description.name}`"
                    self.report.add("audit-description-broken", message, child.span)
                description.bodies.setdefault(name, self.body(child))
            elif child.tag == "frame":
                description.frames.add(name)
            elif child.tag == "plugin":
                description.facts += plugin_facts(child)
        for child in self.model.children:
            if child.tag == "joint":
                joint = self.joint(child)
                if joint is not None:
                    description.joints.setdefault(joint.name, joint)

    def pose(self, element: Element, depth: int = 0) -> Pose:
        """Returns the pose of a link, joint or frame in the frame of the model."""
        own = element.find("pose")
        values = numbers(own.text, 6) if own is not None and own.text else None
        degrees = own is not None and own.attributes.get("degrees") == "true"
        pose = Pose()
        if values is not None:
            rpy: Vec3 = (values[3], values[4], values[5])
            rpy = scale(0.017453292519943295, rpy) if degrees else rpy
            pose = Pose.from_xyz_rpy((values[0], values[1], values[2]), rpy)
        reference = own.attributes.get("relative_to", "") if own is not None else ""
        if not reference and element.tag == "joint":
            reference = _text(element, "child")
        if not reference and element.tag == "frame":
            reference = element.attributes.get("attached_to", "")
        if reference in self.named and depth < 30:
            return self.pose(self.named[reference], depth + 1) * pose
        return pose

    def body(self, element: Element) -> Body:
        body = Body(element.attributes.get("name", ""), element.span)
        inertial = element.find("inertial")
        if inertial is not None:
            mass, inertia = inertial.find("mass"), inertial.find("inertia")
            if mass is not None:
                body.mass, body.mass_span = _number(inertial, "mass"), mass.span
            if inertia is not None:
                names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
                defaults = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
                entries = [_number(inertia, name) for name in names]
                body.inertia = tuple(
                    default if entry is None else entry
                    for entry, default in zip(entries, defaults, strict=True)
                )
                body.inertia_span = inertia.span
        for child in element.children:
            if child.tag in ("visual", "collision"):
                shape = _shape(child, self.pose(child))
                if shape is not None:
                    body.shapes.append(shape)
            elif child.tag == "sensor":
                frame = child.find("gz_frame_id") or child.find("frame_id")
                if frame is not None:
                    subject = f"sensor `{child.attributes.get('name', '')}`"
                    fact = Fact("frame", subject, frame.text.strip(), frame.span)
                    self.description.facts.append(fact)
                self.description.frames.add(child.attributes.get("name", ""))
        return body

    def joint(self, element: Element) -> BodyJoint | None:
        name, kind = element.attributes.get("name", ""), element.attributes.get("type", "")
        parent, child = _text(element, "parent"), _text(element, "child")
        for role, link in (("parent", parent), ("child", child)):
            known = [*self.description.bodies, *self.description.frames]
            if link and link != "world" and "::" not in link and link not in self.named:
                self.report.add(
                    "audit-description-broken",
                    f"the {role} of joint `{name}` is link `{link}`, which does not exist",
                    element.span,
                    hint=did_you_mean(link, known, fixable=False),
                )
        if child not in self.named:
            return None
        X_MC = self.pose(self.named[child])
        X_MP = self.pose(self.named[parent]) if parent in self.named else Pose()
        X_MJ = self.pose(element)
        X_CJ = X_MC.inverse() * X_MJ
        axis_element = element.find("axis")
        xyz = axis_element.find("xyz") if axis_element is not None else None
        values = numbers(xyz.text, 3) if xyz is not None else None
        axis: Vec3 = (values[0], values[1], values[2]) if values else (0.0, 0.0, 1.0)
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
        limit = axis_element.find("limit") if axis_element is not None else None
        linear = kind == "prismatic"
        for quantity, unit in _LIMITS.items():
            number = _number(limit, quantity)
            place = limit.find(quantity) if limit is not None else None
            if number is not None and place is not None and abs(number) < UNLIMITED:
                shown = _LINEAR[unit] if linear else unit
                if quantity in ("velocity", "effort") and number < 0.0:
                    continue  # a negative value means no limit
                joint.limits[quantity] = Fact(quantity, name, number, place.span, shown)
        return joint


_LIMITS = {"lower": "rad", "upper": "rad", "velocity": "rad/s", "effort": "N m"}
_LINEAR = {"rad": "m", "rad/s": "m/s", "N m": "N"}


def _shape(owner: Element, pose: Pose) -> SolidShape | None:
    geometry = owner.find("geometry")
    if geometry is None or not geometry.children:
        return None
    shape = geometry.children[0]
    size: tuple[float, ...] | None = None
    mesh = ""
    if shape.tag == "box":
        size = numbers(_text(shape, "size"), 3)
    elif shape.tag in ("cylinder", "capsule"):
        size = numbers(f"{_text(shape, 'radius')} {_text(shape, 'length')}", 2)
    elif shape.tag == "sphere":
        size = numbers(_text(shape, "radius"), 1)
    elif shape.tag == "ellipsoid":
        size = numbers(_text(shape, "radii"), 3)
    elif shape.tag == "mesh":
        size, mesh = numbers(_text(shape, "scale") or "1 1 1", 3), _text(shape, "uri")
    if size is None:
        return None
    return SolidShape(shape.tag, size, pose, owner.tag == "collision", shape.span, mesh)
