"""Converts MJCF files, as MuJoCo compiles them in a worker process, to URDF elements."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from thorvaldc.compiler.descriptions.facts import UnreadableFileError
from thorvaldc.compiler.extras.converted_elements import MAX_DEPTH, UrdfElements, read_xml
from thorvaldc.compiler.extras.plugin_facts import walk
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.sandbox.worker_process import (
    Worker,
    WorkerLimitError,
    WorkerLimits,
    limited_worker,
)
from thorvaldc.model import Pose

Include = Callable[[Element], Element]
ReadMesh = Callable[[str, Element], tuple[str, bytes]]
LIMITS = WorkerLimits(wall_seconds=60.0, processor_seconds=30, memory_bytes=2 << 30)
MAX_PARTS = 6000  # the time in which MuJoCo compiles a model grows with their square
MAX_SHOWN_GROUP = 2  # MuJoCo shows no geoms of higher groups
WORLD = "world"
# Other elements and attributes are not handed to MuJoCo: they name files and elements that are not
# read, or make any number of bodies.
_READ = (
    *("mujoco", "compiler", "default", "worldbody", "body", "frame", "inertial", "joint"),
    *("freejoint", "geom", "site", "camera", "include"),
)
_LEFT_OUT = (
    *("material", "hfield", "target", "user", "fluidshape", "fitscale"),
    *("meshdir", "assetdir", "texturedir", "strippath", "content_type"),
)
_WITH_MESHES = ("fitscale",)
_NAMES = ("name", "class", "childclass", "file", "mesh", "model", "joint", "body", "geom", "site")
_NOT_FINITE = re.compile(r"(?i)(?<![\w.])[-+]?(?:nan|inf(?:inity)?)(?![\w.])")


class MjcfParts(NamedTuple):
    """A ``<mujoco>`` document.

    - ``elements``: the links and joints of URDF.
    - ``frames``: names of the sites and cameras.
    - ``others``: elements that MuJoCo did not get, and meshes without a file.
    """

    elements: list[Element]
    frames: list[str]
    others: list[Element]


def mujoco_worker() -> Worker:
    """Returns a worker for ``read_mjcf``: MuJoCo ends the process at some files."""
    folders = [os.path.abspath(folder) for folder in sys.path]
    return limited_worker(__name__, LIMITS, path=folders, imports=["mujoco"])


def read_mjcf(
    root: Element, include: Include, worker: Worker, read_mesh: ReadMesh | None = None
) -> MjcfParts:
    """Returns the parts of a ``<mujoco>`` document.

    - ``include``: function that returns the root of the file that an ``<include>`` names.
    - ``read_mesh``: function that returns the name and the content of a mesh file.  Without it,
      meshes and all numbers that MuJoCo computes from others, such as masses from densities, are
      left out.

    Raises ``UnreadableFileError`` if MuJoCo rejects the document, or if it is too large.
    """
    text = _Text(include, read_mesh)
    request = {"text": "".join(text.lines(root)), "is_whole": read_mesh is not None}
    files = text.mesh_files()
    request |= {"meshes": [(name, path, len(data)) for name, path, data in files]}
    try:
        answer, _ = worker.ask(request, b"".join(data for *_, data in files))
    except WorkerLimitError as error:
        raise UnreadableFileError(f"MuJoCo {error}", root.span) from None
    if "error" in answer:
        reason, _, place = answer["error"].removeprefix("XML Error: ").partition("\n")
        line = place.rpartition("line ")[2].strip()
        span = text.sources[int(line) - 1].span if line.isdecimal() else root.span
        reason = reason.removeprefix("Error: ")
        raise UnreadableFileError(f"MuJoCo rejects it: {reason}", span)
    elements = [_unpacked(packed, text.sources) for packed in answer["elements"]]
    return MjcfParts(elements, answer["frames"], text.others)


def _unpacked(packed: Any, sources: list[Element]) -> Element:
    tag, attributes, line, children = packed
    source, inner = sources[line - 1], tuple(_unpacked(child, sources) for child in children)
    return Element(tag, attributes, inner, "", source.span, (), source.file)


class _Text:
    """Writes the text for MuJoCo: each start tag is a line, whose number MuJoCo keeps.

    - ``sources``: element of each line.
    - ``others``: as in ``MjcfParts``.
    """

    def __init__(self, include: Include, read_mesh: ReadMesh | None) -> None:
        self.include, self.read_mesh = include, read_mesh
        self.read = (*_READ, *(("asset", "mesh") if read_mesh is not None else ()))
        self.sources: list[Element] = []
        self.others: list[Element] = []

    def lines(self, element: Element, depth: int = 0) -> Iterator[str]:
        """Yields the text of an element.

        An ``<include>`` is an empty line before the content of the other file.
        """
        self.sources.append(element)
        if len(self.sources) > MAX_PARTS or depth > MAX_DEPTH:
            text = f"it has more than {MAX_PARTS} elements or {MAX_DEPTH} levels, with its includes"
            raise UnreadableFileError(text)
        kept = _WITH_MESHES if self.read_mesh is not None else ()
        stated = {n: v for n, v in element.attributes.items() if n in kept or n not in _LEFT_OUT}
        for name, value in stated.items():
            if _NOT_FINITE.search(value) and name not in _NAMES:
                raise UnreadableFileError(f"`{name}` is not a finite number", element.span)
        if element.tag == "mesh" and "file" in stated:
            stated |= {"name": mesh_name(element), "file": _mesh_file(element)}
        elif element.tag == "mesh" and {"vertex", "builtin"} & stated.keys():
            self.others.append(element)  # it has no file
        is_include = element.tag == "include"
        text = f"<{element.tag}{''.join(f' {n}={quoteattr(v)}' for n, v in stated.items())}>"
        yield "\n" if is_include else f"{text}\n"
        for child in self.include(element).children if is_include else element.children:
            is_terrain = child.tag == "geom" and child.attributes.get("type") == "hfield"
            if child.tag in self.read and not is_terrain:
                yield from self.lines(child, depth + 1)
            else:
                self.others.append(child)
        yield "" if is_include else f"</{element.tag}>"

    def mesh_files(self) -> list[tuple[str, str, bytes]]:
        """Returns the name, the path and the content of the mesh file of each line that has one."""
        if self.read_mesh is None:
            return []
        compilers = [e.attributes for e in self.sources if e.tag == "compiler"]
        # The last one of several counts.
        folders = [c.get("meshdir", c.get("assetdir")) for c in reversed(compilers)]
        folder = next((name for name in folders if name is not None), "")
        strips = [c["strippath"] == "true" for c in reversed(compilers) if "strippath" in c]
        files: list[tuple[str, str, bytes]] = []
        for element in self.sources:
            if element.tag == "mesh" and (name := element.attributes.get("file")):
                name = os.path.basename(name) if strips[:1] == [True] else name
                path, data = self.read_mesh(os.path.join(folder, name), element)
                files.append((mesh_name(element), path, data))
        return files


def mesh_name(element: Element) -> str:
    return element.attributes.get("name") or Path(element.attributes["file"]).stem


def _mesh_file(element: Element) -> str:
    """Returns the name that MuJoCo gets for the mesh file of an element."""
    is_obj = element.attributes["file"].lower().endswith(".obj")
    return f"{mesh_name(element)}.{'obj' if is_obj else 'stl'}"


# -- worker process ----------------------------------------------------------------------


def answer(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the URDF elements of a model, or why MuJoCo rejects it."""
    import mujoco

    mujoco.set_mju_user_warning(_ignore)  # otherwise MuJoCo writes a file
    sources = {e.span.line: e for e in walk(read_xml(request["text"].encode(), "", Path()))}
    files = {
        e.attributes["name"]: e.attributes["file"]
        for e in sources.values()
        if e.tag == "mesh" and "file" in e.attributes
    }
    assets: dict[str, bytes] = {}
    for name, _, size in request["meshes"]:
        assets[files[name]], data = data[:size], data[size:]
    try:
        spec = mujoco.MjSpec.from_string(request["text"], assets=assets)
        paths = {name: path for name, path, _ in request["meshes"]}
        reader = _Reader(spec, sources, paths if request["is_whole"] else None)
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
    - ``paths``: path of each mesh file by the name of the mesh, or ``None`` if there are no files.
    """

    def __init__(
        self, spec: Any, sources: Mapping[int, Element], paths: Mapping[str, str] | None
    ) -> None:
        self.spec, self.sources, self.paths = spec, sources, paths
        self.meshes: dict[Any, str] = {}
        self.inertials: dict[Any, Element] = {}
        spec.compiler.fusestatic = spec.compiler.discardvisual = spec.compiler.usethread = False
        for kind, parts in (("body", spec.bodies), ("joint", spec.joints)):
            for number, part in enumerate(parts):
                part.name = part.name or f"unnamed {kind} {number}"
        if paths is None:
            self.leave_out_files_and_masses(spec)

    def leave_out_files_and_masses(self, spec: Any) -> None:
        """Makes a model that MuJoCo compiles without its mesh files and with any masses."""
        for geom in spec.geoms:
            if geom.meshname or geom.type.name in ("mjGEOM_MESH", "mjGEOM_HFIELD", "mjGEOM_SDF"):
                self.meshes[geom] = geom.meshname or "mesh"
                geom.meshname, geom.type, geom.size = "", type(geom.type).mjGEOM_BOX, [1, 1, 1]
        for body in spec.bodies[1:]:
            if body.explicitinertial:
                self.inertials[body] = self.stated_inertial(body)
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
            body.fullinertia = [math.nan] * 6

    def stated_inertial(self, body: Any) -> Element:
        full, urdf = body.fullinertia, self.urdf(body, "inertial")
        moments = [*body.inertia, 0, 0, 0] if math.isnan(full[0]) else full
        stated = {name: str(moment) for name, moment in zip(_MOMENTS, moments, strict=True)}
        mass = urdf.element("mass", value=str(body.mass))
        return urdf.element("inertial", mass, urdf.element("inertia", **stated))

    def inertial(self, body: Any, X_LB: Pose, model: Any) -> Element | None:
        index, urdf = body.id, self.urdf(body, "inertial")
        if self.paths is None or model.body_mass[index] <= 0.0:
            return self.inertials.get(body)
        moments = [*model.body_inertia[index].tolist(), 0, 0, 0]
        stated = {name: str(moment) for name, moment in zip(_MOMENTS, moments, strict=True)}
        return urdf.element(
            "inertial",
            urdf.origin(X_LB * _pose(model.body_ipos[index], model.body_iquat[index])),
            urdf.element("mass", value=str(model.body_mass[index])),
            urdf.element("inertia", **stated),
        )

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
            shapes = [
                shape for geom in body.geoms for shape in self.shapes(geom, anchor.inverse(), model)
            ]
            inertial = self.inertial(body, anchor.inverse(), model)
            yield urdf.element("link", inertial, *shapes, name=name)
            if parent.id and not body.joints:
                yield urdf.joint(f"fixed joint of {name}", "fixed", above, name, pose)
            for joint in body.joints:
                kind = _KINDS.get(joint.type.name, "ball")
                if self.paths is not None and kind == "floating":
                    continue  # the root of URDF floats
                zero = float(model.qpos0[model.jnt_qposadr[joint.id]])
                lower, upper = (limit - zero for limit in model.jnt_range[joint.id].tolist())
                limits = {"lower": lower, "upper": upper} if model.jnt_limited[joint.id] else {}
                placed = (above, name, pose, model.jnt_axis[joint.id].tolist())
                dof = model.jnt_dofadr[joint.id]
                losses = {
                    "damping": str(model.dof_damping[dof].flat[0]),
                    "friction": str(model.dof_frictionloss[dof]),
                }
                yield self.urdf(joint).joint(joint.name, kind, *placed, limits, None, losses)
                above = WORLD  # the first joint connects the body

    def shapes(self, geom: Any, X_LB: Pose, model: Any) -> Iterator[Element]:
        """Yields the shape of a geom; a capsule and a tyre become cylinders."""
        index, (a, b, c) = geom.id, model.geom_size[geom.id]
        kind = type(geom.type)(int(model.geom_type[index])).name.removeprefix("mjGEOM_").lower()
        urdf, values = self.urdf(geom), {}
        pose = X_LB * _pose(model.geom_pos[index], model.geom_quat[index])
        if kind == "mesh" and self.paths is not None:
            mesh = model.geom_dataid[index]
            # MuJoCo moves the points of a mesh to its own axes.
            pose *= _pose(model.mesh_pos[mesh], model.mesh_quat[mesh]).inverse()
            scale = " ".join(map(str, model.mesh_scale[mesh].tolist()))
            if geom.meshname not in self.paths:
                return  # it has no file
            values = {"filename": self.paths[geom.meshname], "scale": scale}
        elif geom in self.meshes or (kind == "ellipsoid" and not math.isclose(a, b)):
            kind, values = "mesh", {"filename": self.meshes.get(geom, kind)}
        elif kind == "box":
            values = {"size": f"{2.0 * a} {2.0 * b} {2.0 * c}"}
        elif kind == "sphere":
            values = {"radius": str(a)}
        elif kind in ("cylinder", "capsule", "ellipsoid"):
            length = c if kind == "ellipsoid" else b
            kind, values = "cylinder", {"radius": str(a), "length": str(2.0 * length)}
        elif self.paths is None:
            return
        geometry = urdf.element("geometry", urdf.element(kind, **values))
        if geom.contype or geom.conaffinity:
            yield urdf.element("collision", urdf.origin(pose), geometry)
            if self.paths is None or geom.group > MAX_SHOWN_GROUP:
                return
        color = urdf.element("color", rgba=" ".join(map(str, model.geom_rgba[index].tolist())))
        yield urdf.element("visual", urdf.origin(pose), geometry, urdf.element("material", color))


_KINDS = {"mjJNT_HINGE": "revolute", "mjJNT_SLIDE": "prismatic", "mjJNT_FREE": "floating"}
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _pose(position: Any, quat: Any = (1.0, 0.0, 0.0, 0.0)) -> Pose:
    (x, y, z), (a, b, c, d) = position, quat
    return Pose((float(x), float(y), float(z)), (float(a), float(b), float(c), float(d)))
