"""Rules about bodies: masses, inertias, sizes, units, mesh files, and the footprint of Nav2."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from thorvaldc.compiler.shapes.meshes import load_mesh, shared_mesh_workers
from thorvaldc.diagnostics import Label, Report, Span, plain
from thorvaldc.diagnostics.files import read_json
from thorvaldc.model import Inertial, Mesh, Pose
from thorvaldc.model.statics.tip_over import convex_hull
from thorvaldc.model.stl import RECORD, stl_triangles
from thorvaldc.model.sums import float_sum
from thorvaldc.tools.audit import audit_facts as facts

# Rounded inertias of thin bodies may break the triangle inequality a little.
TOLERANCE = 0.01
# Osmium has 22 590 kg/m^3; the air in a closed box of sheet metal makes 5 kg/m^3 possible.
MAX_DENSITY, MIN_DENSITY = 30_000.0, 1.0
MAX_LENGTH = 20.0  # m
MAX_ANGLE = 4.0 * math.pi + 0.01  # rad; larger limits of joints are probably degrees


def _bodies(evidence: facts.Evidence) -> Iterator[tuple[facts.Description, facts.Body]]:
    for description in evidence.descriptions:
        for body in description.bodies.values():
            yield description, body


def _moving(description: facts.Description) -> set[str]:
    """Returns the bodies that move against their parent and carry no fixed body with a mass."""
    moving = {
        joint.child for joint in description.joints.values() if joint.kind not in ("fixed", "free")
    }
    carrying = {
        joint.parent
        for joint in description.joints.values()
        if joint.kind == "fixed" and joint.child in description.bodies
    }
    return moving - carrying


def check_masses(evidence: facts.Evidence, report: Report) -> None:
    """Reports masses that are negative, and moving bodies whose mass is zero."""
    for description, body in _bodies(evidence):
        if body.mass is None or body.mass_span is None:
            continue
        zero = body.mass == 0.0 and body.name in _moving(description)
        if body.mass < 0.0 or zero:
            what = "moves, but has the mass 0" if zero else f"has the mass {body.mass:g} kg"
            report.add(
                "audit-mass",
                f"body `{body.name}` {what}; simulators reject it or drop the body",
                body.mass_span,
                hint="weigh the part, or estimate: volume times density",
            )


def check_inertias(evidence: facts.Evidence, report: Report) -> None:
    """Reports inertias that no body has, and those too large for the size of the body."""
    for description, body in _bodies(evidence):
        if body.inertia is None or body.inertia_span is None or len(body.inertia) != 6:
            continue
        xx, yy, zz, xy, xz, yz = body.inertia
        inertial = Inertial(body.mass or 0.0, (0.0, 0.0, 0.0), (xx, yy, zz, xy, xz, yz))
        low, middle, high = inertial.principal_moments()
        reason = ""
        if low < -1e-9 - TOLERANCE * abs(high):
            reason = "one is negative"
        elif high > (low + middle) * (1.0 + TOLERANCE) + 1e-12:
            reason = "one exceeds the sum of the others"
        elif high <= 0.0 and (body.mass or 0.0) > 0.0 and body.name in _moving(description):
            reason = "a moving body needs an inertia"
        if reason:
            report.add(
                "audit-inertia",
                f"body `{body.name}` has the principal moments of inertia {low:.4g}, {middle:.4g},"
                f" {high:.4g} kg m^2: {reason}",
                body.inertia_span,
                hint="compute them from the shape; for a box: ixx = m (y^2 + z^2) / 12",
            )
            continue
        reach = _reach(body)
        if body.mass and body.mass > 0.0 and reach is not None and high > body.mass * reach**2:
            report.add(
                "audit-inertia-size",
                f"body `{body.name}` has a moment of inertia of {high:.4g} kg m^2, but its"
                f" {body.mass:g} kg within {plain(reach, 3)} m can have at most"
                f" {body.mass * reach**2:.4g} kg m^2",
                body.inertia_span,
                hint="the unit is kg m^2, about the centre of mass; kg mm^2 are 1e-6 of that",
            )


def _half_diagonal(shape: facts.SolidShape) -> float | None:
    size = shape.size
    if shape.kind == "box":
        return math.hypot(*size) / 2.0
    if shape.kind in ("cylinder", "tyre"):
        return math.hypot(size[0], size[1] / 2.0)
    if shape.kind == "capsule":
        return size[0] + size[1] / 2.0
    if shape.kind in ("sphere", "ellipsoid"):
        return max(size)
    return None


def _reach(body: facts.Body) -> float | None:
    """Returns an upper limit of the distance of two points of a body in m, if it is known."""
    reaches: list[float] = []
    for shape in body.shapes:
        half = _half_diagonal(shape)
        if half is None:
            return None
        reaches.append(half + math.hypot(*shape.pose.xyz))
    return 2.0 * max(reaches) if reaches else None


def _volume(shape: facts.SolidShape) -> float | None:
    size = shape.size
    if shape.kind == "box":
        return size[0] * size[1] * size[2]
    if shape.kind in ("cylinder", "tyre"):
        return math.pi * size[0] ** 2 * size[1]
    if shape.kind == "sphere":
        return 4.0 / 3.0 * math.pi * size[0] ** 3
    if shape.kind == "capsule":
        return math.pi * size[0] ** 2 * (size[1] + 4.0 / 3.0 * size[0])
    if shape.kind == "ellipsoid":
        return 4.0 / 3.0 * math.pi * size[0] * size[1] * size[2]
    return None


def check_densities(evidence: facts.Evidence, report: Report) -> None:
    """Reports bodies that are denser than any metal, or lighter than air in a foil."""
    for description, body in _bodies(evidence):
        if body.mass is None or body.mass_span is None or body.mass <= 0.0:
            continue
        volumes: list[float] = []
        for collides in (True, False):
            parts = [_volume(shape) for shape in body.shapes if shape.collides is collides]
            if any(part is None for part in parts):
                volumes = []
                break
            volumes.append(float_sum(part for part in parts if part is not None))
        if not volumes or max(volumes) <= 0.0 or body.name in _carriers(description):
            continue
        density = body.mass / max(volumes)
        if density > MAX_DENSITY or density < MIN_DENSITY:
            compared = "denser than any metal" if density > MAX_DENSITY else "lighter than air"
            report.add(
                "audit-density",
                f"body `{body.name}` has {body.mass:g} kg in {max(volumes):.3g} m^3, which is"
                f" {density:.3g} kg/m^3: {compared}",
                body.mass_span,
                hint="masses are in kg and lengths in m; is one of them in g or mm?",
            )


def _carriers(description: facts.Description) -> set[str]:
    """Returns bodies to which fixed joints attach bodies with shapes: their mass may be merged."""
    return {
        joint.parent
        for joint in description.joints.values()
        if joint.kind == "fixed"
        and joint.child in description.bodies
        and description.bodies[joint.child].shapes
    }


def check_lengths(evidence: facts.Evidence, report: Report) -> None:
    """Reports shapes and meshes of a size that suggests millimetres, and missing mesh files."""
    for _, body in _bodies(evidence):
        for shape in body.shapes:
            if shape.kind not in ("mesh", "plane") and max(shape.size) > MAX_LENGTH:
                report.add(
                    "audit-length-unit",
                    f"a {shape.kind} of body `{body.name}` measures {plain(max(shape.size))} m",
                    shape.span,
                    hint="lengths are in m; is this one in mm?",
                )
    meshes = _meshes(evidence)
    boxes = _mesh_boxes(dict.fromkeys(path for _, _, path in meshes))
    for body, shape, path in meshes:
        box = boxes.get(path)
        if box is None:
            if not path.exists():
                report.add(
                    "audit-mesh-missing",
                    f"the mesh file `{shape.mesh}` does not exist",
                    shape.span,
                    hint="check spelling and case; paths are relative to the package",
                )
            continue
        edges = [
            abs(scale) * (high - low)
            for scale, low, high in zip(shape.size, box[0], box[1], strict=True)
        ]
        largest, other, hint = max(edges), _size_of_others(body, shape), ""
        if largest > MAX_LENGTH or (other is not None and largest > 100.0 * other):
            is_scaled = max(map(abs, shape.size)) <= 0.1
            hint = (
                "is its scale right?" if is_scaled else "is it in mm? use it with a scale of 0.001"
            )
        elif 0.0 < largest < 1e-4:
            hint = "is it in m already, so that the scale 0.001 is too much?"
        if hint:
            report.add(
                "audit-length-unit",
                f"the mesh `{shape.mesh}` of body `{body.name}` measures {plain(largest, 3)} m",
                shape.span,
                hint=hint,
            )


def _size_of_others(body: facts.Body, mesh: facts.SolidShape) -> float | None:
    """Returns the largest half diagonal of the other shapes of a body, if it is known."""
    halves = [_half_diagonal(shape) for shape in body.shapes if shape is not mesh]
    known = [half for half in halves if half is not None and half > 0.0]
    return max(known) if known else None


Box = tuple[Sequence[float], Sequence[float]]
MESH_SECONDS = 30.0
MAX_MESHES = 300
_VERTICES = 30_000  # of a mesh with more, a part is read


def _meshes(evidence: facts.Evidence) -> list[tuple[facts.Body, facts.SolidShape, Path]]:
    """Returns the meshes of URDF and SDF with their files, if their package is audited."""
    paths: dict[tuple[Path, str], Path | None] = {}
    meshes: list[tuple[facts.Body, facts.SolidShape, Path]] = []
    for description, body in _bodies(evidence):
        for shape in body.shapes if description.format != "MJCF" else ():
            if shape.kind == "mesh":
                key = description.path.parent, shape.mesh
                if key not in paths:
                    paths[key] = _mesh_path(shape.mesh, description, evidence)
                path = paths[key]
                meshes += [(body, shape, path)] if path is not None else []
    return meshes


def _mesh_path(name: str, description: facts.Description, evidence: facts.Evidence) -> Path | None:
    for scheme in ("package://", "model://", "$(find "):
        if name.startswith(scheme):
            return evidence.file_in_package(
                unquote(name.removeprefix(scheme)).replace(")/", "/", 1)
            )
    if name.startswith("file://"):
        path = Path(unquote(name.removeprefix("file://")))
        return path if path.is_absolute() and str(path) != "/" else None
    return description.path.parent / name if name and "://" not in name else None


def _mesh_boxes(paths: Iterable[Path]) -> dict[Path, Box]:
    """Returns the corners (m) of the bounding boxes of meshes that can be read, with scale 1.

    The time and the number of meshes are limited.
    """
    boxes: dict[Path, Box] = {}
    end = time.monotonic() + MESH_SECONDS
    with shared_mesh_workers():
        for path in itertools.islice(filter(_is_file, paths), MAX_MESHES):
            if time.monotonic() > end:
                break
            mesh = load_mesh(path, Span(path.name), Report(), display=path.name)
            points = _points(mesh) if mesh is not None else []
            if points:
                axes = list(zip(*points, strict=True))
                boxes[path] = [min(axis) for axis in axes], [max(axis) for axis in axes]
    return boxes


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _points(mesh: Mesh) -> list[tuple[float, ...]]:
    if mesh.name.endswith(".obj"):
        lines = (line for line in mesh.data.splitlines() if line.startswith(b"v "))
        return [tuple(float(word) for word in line.split()[1:4]) for line in lines]
    step = max(1, len(mesh.data) // RECORD * 3 // _VERTICES)
    return list(itertools.chain.from_iterable(stl_triangles(mesh.data, step)))


def check_angles(evidence: facts.Evidence, report: Report) -> None:
    """Reports angles of joints that suggest degrees."""
    for description in evidence.descriptions:
        for joint in description.joints.values():
            if joint.kind not in ("revolute", "hinge"):
                continue
            for name in ("lower", "upper"):
                limit = joint.limits.get(name)
                if limit is None or abs(limit.value) <= MAX_ANGLE:
                    continue
                if abs(limit.value) > 1e4:  # a way to write "no limit"
                    continue
                report.add(
                    "audit-angle-unit",
                    f"the {name} limit of joint `{joint.name}` is {limit.value:g} rad, which is"
                    f" {abs(limit.value) / (2 * math.pi):.3g} turns",
                    limit.span,
                    hint=f"is it in degrees? {limit.value:g} degrees are"
                    f" {math.radians(limit.value):.6g} rad",
                )


# -- footprints of Nav2 -----------------------------------------------------------------

# A footprint may leave out screws and round corners.
FOOTPRINT_TOLERANCE = 0.02  # m

Point = tuple[float, float]


def footprint_of(section: facts.ParameterSection) -> facts.Fact | None:
    """Returns the polygon (m) or the radius (m) of a costmap, or ``None``."""
    subject = f"`{section.node}`"
    node = section.values.get("footprint")
    if node is not None and isinstance(node.value, str) and len(node.value) < 10_000:
        polygon = _polygon(node.value)
        if polygon is not None:
            return facts.Fact("footprint", subject, polygon, node.span, "m")
    radius = section.number("robot_radius")
    if radius is not None and radius > 0.0:
        return facts.Fact("footprint", subject, radius, section.values["robot_radius"].span, "m")
    return None


def _polygon(text: str) -> tuple[Point, ...] | None:
    try:
        points = read_json(text)
    except ValueError:
        return None
    if not isinstance(points, list) or len(points) < 3:
        return None
    for point in points:
        if not isinstance(point, list) or len(point) != 2:
            return None
        if not all(isinstance(v, int | float) and abs(v) < 1e6 for v in point):
            return None
    return tuple((float(x), float(y)) for x, y in points)


def check_footprints_agree(evidence: facts.Evidence, report: Report) -> None:
    """Reports costmaps of one file with different footprints."""
    by_file: dict[str, facts.Fact] = {}
    for section in evidence.sections:
        fact = footprint_of(section)
        if fact is None or not section.short_name.endswith("costmap"):
            continue
        first = by_file.setdefault(fact.span.file, fact)
        if _shown(first) != _shown(fact):
            report.add(
                "audit-footprints-differ",
                f"{fact.subject} has the footprint {_shown(fact)}, but {first.subject} has"
                f" {_shown(first)}",
                fact.span,
                hint="the robot is the same in both; margins belong in inflation_radius or"
                " footprint_padding",
                labels=[Label(first.span, "the other footprint")],
            )


def _shown(fact: facts.Fact) -> str:
    if isinstance(fact.value, tuple):
        points = ", ".join(f"[{x:g}, {y:g}]" for x, y in fact.value[:8])
        return f"[{points}{', ...' if len(fact.value) > 8 else ''}]"
    return f"of radius {plain(fact.value)} m"


def check_footprints_cover(evidence: facts.Evidence, report: Report) -> None:
    """Reports footprints that leave out a part of the collision shapes."""
    for section in evidence.sections:
        fact = footprint_of(section)
        if fact is None:
            continue
        padding = section.number("footprint_padding")
        margin = FOOTPRINT_TOLERANCE + (padding if padding is not None else 0.01)
        base = (section.text("robot_base_frame") or "base_link").strip("/")
        outside = [farthest_outside(d, base, fact) for d in evidence.related(fact.span.file)]
        known = [part for part in outside if part is not None]
        if not known or len(known) < len(outside):
            continue
        distance, body, shape = min(known, key=lambda part: part[0])
        if distance > margin:
            report.add(
                "audit-footprint",
                f"the footprint of {fact.subject} leaves out {plain(distance, 3)} m of body "
                f"`{body}`",
                fact.span,
                hint="the planner steers this part into obstacles; enlarge the footprint",
                labels=[Label(shape.span, "this shape")],
            )


def farthest_outside(
    description: facts.Description, base: str, fact: facts.Fact
) -> tuple[float, str, facts.SolidShape] | None:
    """Returns how far a body stands out of a footprint (m; negative: inside), and its shape.

    Only bodies on fixed joints and wheels count: an arm moves.  Meshes are left out.
    """
    poses = description.root_poses()
    if base not in poses:
        return None
    parents = {joint.child: joint for joint in description.joints.values()}
    X_BW = poses[base].inverse()
    best: tuple[float, str, facts.SolidShape] | None = None
    for name, body in description.bodies.items():
        if not _is_rigid(name, parents):
            continue
        for shape in body.shapes:
            if not shape.collides or name not in poses:
                continue
            for x, y in _outline(shape, X_BW * poses[name]):
                distance = _distance(fact, x, y)
                if best is None or distance > best[0]:
                    best = distance, name, shape
    return best


def _is_rigid(name: str, parents: Mapping[str, facts.BodyJoint]) -> bool:
    for _ in range(100):
        joint = parents.get(name)
        if joint is None:
            return True
        if joint.kind not in ("fixed", "continuous", "free"):
            return False
        name = joint.parent
    return False


def _outline(shape: facts.SolidShape, X_BL: Pose) -> list[Point]:
    """Returns points of a shape that stand out farthest, in the frame of the robot."""
    pose = X_BL * shape.pose
    size = shape.size
    if shape.kind == "box":
        corners = itertools.product(*((-edge / 2, edge / 2) for edge in size))
        return [pose.apply((x, y, z))[:2] for x, y, z in corners]
    if shape.kind == "sphere":
        x, y, _ = pose.xyz
        return [(x + size[0] * c, y + size[0] * s) for c, s in _CIRCLE]
    if shape.kind in ("cylinder", "tyre"):
        ends = [(size[0] * c, size[0] * s, z * size[1] / 2) for c, s in _CIRCLE for z in (-1, 1)]
        return [pose.apply(end)[:2] for end in ends]
    return []


_CIRCLE = [(math.cos(i * math.pi / 12), math.sin(i * math.pi / 12)) for i in range(24)]


def _distance(fact: facts.Fact, x: float, y: float) -> float:
    """Returns the distance of a point from a footprint in m, negative inside."""
    if not isinstance(fact.value, tuple):
        return math.hypot(x, y) - float(fact.value)
    hull = convex_hull(fact.value)  # counter-clockwise
    if len(hull) < 3:
        return math.inf
    outside = -math.inf
    for (ax, ay), (bx, by) in zip(hull, (*hull[1:], hull[0]), strict=True):
        length = math.hypot(bx - ax, by - ay)
        if length > 0.0:
            cross = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / length
            outside = max(outside, -cross)
    return outside
