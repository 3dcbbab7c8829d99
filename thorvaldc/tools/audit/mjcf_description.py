"""Converts MJCF files, as MuJoCo compiles them in a worker process, to URDF elements.

Numbers that MuJoCo computes from others, such as masses from densities, are left out.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from thorvaldc.compiler.descriptions.facts import FileDescription, UnreadableFileError
from thorvaldc.compiler.extras.plugin_facts import walk
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.sandbox.worker_process import (
    Worker,
    WorkerLimitError,
    WorkerLimits,
    limited_worker,
)
from thorvaldc.diagnostics import Report
from thorvaldc.model import Pose
from thorvaldc.tools.audit.descriptions import MAX_DEPTH, UrdfElements, read_description, read_xml

Include = Callable[[Element], Element]
LIMITS = WorkerLimits(wall_seconds=60.0, processor_seconds=30, memory_bytes=2 << 30)
MAX_PARTS = 6000  # the time in which MuJoCo compiles a model grows with their square
WORLD = "world"
# Other elements and attributes are not handed to MuJoCo: they name files and elements that are not
# read, or make any number of bodies.
_READ = (
    *("mujoco", "compiler", "default", "worldbody", "body", "frame", "inertial", "joint"),
    *("freejoint", "geom", "site", "camera", "include"),
)
_LEFT_OUT = ("material", "hfield", "target", "user", "fluidshape", "fitscale")


def mujoco_worker() -> Worker:
    """Returns a worker for ``read_mjcf_description``: MuJoCo ends the process at some files."""
    folders = [os.path.abspath(folder) for folder in sys.path]
    return limited_worker(__name__, LIMITS, path=folders, imports=["mujoco"])


def read_mjcf_description(
    root: Element, file: str, path: Path, include: Include, worker: Worker
) -> FileDescription | None:
    """Returns the robot of a ``<mujoco>`` document, or ``None`` if it has no bodies with joints.

    - ``include``: function that returns the root of the file that an ``<include>`` names.

    Raises ``UnreadableFileError`` if MuJoCo rejects the document, or if it is too large.
    """
    name = root.attributes.get("model", Path(file).name)
    description = FileDescription(format="MJCF", name=name, file=file, path=path)
    sources: list[Element] = []
    text = "".join(_lines(root, include, sources))
    try:
        answer, _ = worker.ask({"text": text})
    except WorkerLimitError as error:
        raise UnreadableFileError(f"MuJoCo {error}", root.span) from None
    if "error" in answer:
        reason, _, place = answer["error"].removeprefix("XML Error: ").partition("\n")
        line = place.rpartition("line ")[2].strip()
        span = sources[int(line) - 1].span if line.isdecimal() else root.span
        reason = reason.removeprefix("Error: ")
        raise UnreadableFileError(f"MuJoCo rejects it: {reason}", span)
    elements = [_unpacked(packed, sources) for packed in answer["elements"]]
    read_description(description, elements, Report())
    description.frames = {*answer["frames"]}
    return description if description.joints else None


def _unpacked(packed: Any, sources: list[Element]) -> Element:
    tag, attributes, line, children = packed
    source, inner = sources[line - 1], tuple(_unpacked(child, sources) for child in children)
    return Element(tag, attributes, inner, "", source.span, (), source.file)


def _lines(
    element: Element, include: Include, elements: list[Element], depth: int = 0
) -> Iterator[str]:
    """Yields the text of an element: each start tag is a line, whose number MuJoCo keeps.

    An ``<include>`` is an empty line before the content of the other file.
    """
    elements.append(element)
    if len(elements) > MAX_PARTS or depth > MAX_DEPTH:
        text = f"it has more than {MAX_PARTS} elements or {MAX_DEPTH} levels, with its includes"
        raise UnreadableFileError(text)
    named = [(n, v) for n, v in element.attributes.items() if n not in _LEFT_OUT]
    is_include = element.tag == "include"
    text = f"<{element.tag}{''.join(f' {n}={quoteattr(v)}' for n, v in named)}>"
    yield "\n" if is_include else f"{text}\n"
    for child in include(element).children if is_include else element.children:
        if child.tag in _READ:
            yield from _lines(child, include, elements, depth + 1)
    yield "" if is_include else f"</{element.tag}>"


# -- worker process ----------------------------------------------------------------------


def answer(request: dict[str, Any], _: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the URDF elements of a model, or why MuJoCo rejects it."""
    import mujoco

    mujoco.set_mju_user_warning(_ignore)  # otherwise MuJoCo writes a file
    root = read_xml(request["text"].encode(), "", Path())
    try:
        spec = mujoco.MjSpec.from_string(request["text"])
        reader = _Reader(spec, {element.span.line: element for element in walk(root)})
        elements = map(_packed, reader.elements_of(spec.compile()))
        frames = [part.name for part in (*spec.sites, *spec.cameras)]
        return {"elements": [*elements], "frames": frames}, b""
    except ValueError as error:
        return {"error": str(error)}, b""


def _ignore(_: str) -> None:
    pass


def _packed(element: Element) -> list[Any]:
    """Returns an element whose place is a line, as an answer has it."""
    children = list(map(_packed, element.children))
    return [element.tag, element.attributes, element.span.line, children]


class _Reader:
    """Makes the URDF elements of the bodies; the frame of a link lies at its first joint.

    - ``sources``: element of each line of the text of ``spec``.
    """

    def __init__(self, spec: Any, sources: Mapping[int, Element]) -> None:
        self.spec, self.sources = spec, sources
        self.meshes: dict[Any, str] = {}
        self.inertials: dict[Any, Element] = {}
        # MuJoCo compiles only models with their mesh files and with valid masses.
        spec.compiler.fusestatic = spec.compiler.discardvisual = False
        for kind, parts in (("body", spec.bodies), ("joint", spec.joints)):
            for number, part in enumerate(parts):
                part.name = part.name or f"unnamed {kind} {number}"
        for geom in spec.geoms:
            if geom.meshname or geom.type.name in ("mjGEOM_MESH", "mjGEOM_HFIELD", "mjGEOM_SDF"):
                self.meshes[geom] = geom.meshname or "mesh"
                geom.meshname, geom.type, geom.size = "", type(geom.type).mjGEOM_BOX, [1, 1, 1]
        for body in spec.bodies[1:]:
            if body.explicitinertial:
                self.inertials[body] = self.inertial(body)
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
            body.fullinertia = [math.nan] * 6

    def inertial(self, body: Any) -> Element:
        full, urdf = body.fullinertia, self.urdf(body, "inertial")
        moments = [*body.inertia, 0, 0, 0] if math.isnan(full[0]) else full
        stated = {name: str(moment) for name, moment in zip(_MOMENTS, moments, strict=True)}
        mass = urdf.element("mass", value=str(body.mass))
        return urdf.element("inertial", mass, urdf.element("inertia", **stated))

    def urdf(self, part: Any, child: str = "") -> UrdfElements:
        if not part.info:  # MuJoCo does not keep the line of a <freejoint>
            return self.urdf(part.parent, "freejoint")
        source = self.sources[int(part.info.removeprefix("line "))]
        return UrdfElements(source.find(child) or source)

    def elements_of(self, model: Any) -> Iterator[Element]:
        anchors = {0: Pose()}
        for body in self.spec.bodies[1:]:
            index, parent, urdf = body.id, body.parent, self.urdf(body)
            name, above = body.name, WORLD
            anchor = _pose(model.jnt_pos[model.body_jntadr[index]]) if body.joints else Pose()
            pose = _pose(model.body_pos[index], model.body_quat[index]) * anchor
            anchors[index] = anchor
            if parent.id:
                above, pose = parent.name, anchors[parent.id].inverse() * pose
            shapes = [self.shape(geom, anchor.inverse(), model) for geom in body.geoms]
            yield urdf.element("link", self.inertials.get(body), *shapes, name=name)
            if parent.id and not body.joints:
                yield urdf.joint(f"fixed joint of {name}", "fixed", above, name, pose)
            for joint in body.joints:
                kind = _KINDS.get(joint.type.name, "ball")
                lower, upper = model.jnt_range[joint.id].tolist()
                limits = {"lower": lower, "upper": upper} if model.jnt_limited[joint.id] else {}
                placed = (above, name, pose, model.jnt_axis[joint.id].tolist())
                yield self.urdf(joint).joint(joint.name, kind, *placed, limits)
                above = WORLD  # the first joint connects the body

    def shape(self, geom: Any, X_LB: Pose, model: Any) -> Element | None:
        """Returns the shape of a geom; a capsule and a tyre become cylinders."""
        kind, (a, b, c) = geom.type.name.removeprefix("mjGEOM_").lower(), model.geom_size[geom.id]
        urdf, values = self.urdf(geom), {}
        if geom in self.meshes or (kind == "ellipsoid" and not math.isclose(a, b)):
            kind, values = "mesh", {"filename": self.meshes.get(geom, kind)}
        elif kind == "box":
            values = {"size": f"{2.0 * a} {2.0 * b} {2.0 * c}"}
        elif kind == "sphere":
            values = {"radius": str(a)}
        elif kind in ("cylinder", "capsule", "ellipsoid"):
            length = c if kind == "ellipsoid" else b
            kind, values = "cylinder", {"radius": str(a), "length": str(2.0 * length)}
        else:
            return None
        pose = X_LB * _pose(model.geom_pos[geom.id], model.geom_quat[geom.id])
        tag = "collision" if geom.contype or geom.conaffinity else "visual"
        geometry = urdf.element("geometry", urdf.element(kind, **values))
        return urdf.element(tag, urdf.origin(pose), geometry)


_KINDS = {"mjJNT_HINGE": "revolute", "mjJNT_SLIDE": "prismatic", "mjJNT_FREE": "floating"}
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _pose(position: Any, quat: Any = (1.0, 0.0, 0.0, 0.0)) -> Pose:
    (x, y, z), (a, b, c, d) = position, quat
    return Pose((float(x), float(y), float(z)), (float(a), float(b), float(c), float(d)))
