"""Rules about bodies: their sizes and units, mesh files, and the footprint of Nav2."""

from __future__ import annotations

import functools
import math
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from thorvaldc.compiler.descriptions.description import PlacedShape
from thorvaldc.compiler.descriptions.description_rules import MAX_LENGTH, check_description
from thorvaldc.compiler.descriptions.facts import Fact, FileDescription, ParameterSection
from thorvaldc.compiler.shapes.meshes import load_mesh, shared_mesh_workers
from thorvaldc.compiler.shapes.solids import measures
from thorvaldc.diagnostics import Label, Report, Span, plain
from thorvaldc.diagnostics.files import read_json
from thorvaldc.model import Joint, Link, MeshShape
from thorvaldc.model.statics.occupied_space import corners_of
from thorvaldc.model.statics.tip_over import Point, convex_hull
from thorvaldc.model.stl import mesh_vertices
from thorvaldc.tools.audit import audit_facts as facts


def check_bodies(evidence: facts.Evidence, report: Report) -> None:
    """Judges all descriptions by the list of rules of ``check``."""
    for description in evidence.descriptions:
        check_description(description, report)


# -- meshes, which are read in a limited time ---------------------------------------------

MESH_SECONDS = 30.0


def check_meshes(evidence: facts.Evidence, report: Report) -> None:
    """Reports meshes of a size that suggests millimetres, and missing mesh files."""
    end, edges_of = time.monotonic() + MESH_SECONDS, functools.cache(_mesh_edges)
    with shared_mesh_workers():
        for description in evidence.descriptions:
            # MuJoCo finds meshes by names that are not read.
            for link in description.links.values() if description.format != "MJCF" else ():
                for shape, _, _, span in description.shapes(link):
                    if not isinstance(shape, MeshShape):
                        continue
                    path = _mesh_path(shape.mesh, description, evidence)
                    if path is not None and not os.path.exists(path):
                        report.add(
                            "audit-mesh-missing",
                            f"the mesh file `{shape.mesh}` does not exist",
                            span,
                            hint="check spelling and case; paths are relative to the package",
                        )
                    elif path is not None and time.monotonic() < end:
                        _check_size(shape, edges_of(path), description, link, span, report)


def _check_size(
    mesh: MeshShape,
    edges: Sequence[float],
    description: FileDescription,
    link: Link,
    span: Span,
    report: Report,
) -> None:
    """Compares the size of a mesh with that of the other shapes of its link."""
    sizes = [size for s in description.shapes(link) if (size := measures(s.shape)) is not None]
    other = max((size.half_diagonal for size in sizes), default=math.inf)
    scaled = [abs(scale) * edge for scale, edge in zip(mesh.scale, edges, strict=False)]
    largest, hint = max(scaled, default=0.0), ""
    if largest > MAX_LENGTH or largest > 100.0 * other:
        is_scaled = max(map(abs, mesh.scale)) <= 0.1
        hint = "is its scale right?" if is_scaled else "is it in mm? use it with a scale of 0.001"
    elif 0.0 < largest < 1e-4:
        hint = "is it in m already, so that the scale 0.001 is too much?"
    if hint:
        report.add(
            "length-unit",
            f"the mesh `{mesh.mesh}` of link `{link.name}` measures {plain(largest, 3)} m",
            span,
            hint=hint,
        )


def _mesh_edges(path: Path) -> list[float]:
    """Returns the edges (m) of the bounding box of a mesh with scale 1; none if it is unread."""
    mesh = load_mesh(path, Span(path.name), Report(), display=path.name)
    points = mesh_vertices(mesh.name, mesh.data) if mesh is not None else ()
    return [max(axis) - min(axis) for axis in zip(*points, strict=True)]


def _mesh_path(name: str, description: FileDescription, evidence: facts.Evidence) -> Path | None:
    for scheme in ("package://", "model://", "$(find "):
        if name.startswith(scheme):
            return evidence.file_in_package(
                unquote(name.removeprefix(scheme)).replace(")/", "/", 1)
            )
    if name.startswith("file://"):
        path = Path(unquote(name.removeprefix("file://")))
        return path if path.is_absolute() and str(path) != "/" else None
    return description.path.parent / name if name and "://" not in name else None


# -- footprints of Nav2 -----------------------------------------------------------------

# A footprint may leave out screws and round corners.
FOOTPRINT_TOLERANCE = 0.02  # m


def footprint_of(section: ParameterSection) -> Fact | None:
    """Returns the polygon (m) or the radius (m) of a costmap, or ``None``."""
    subject = f"`{section.node}`"
    node = section.values.get("footprint")
    if node is not None and isinstance(node.value, str) and len(node.value) < 10_000:
        polygon = _polygon(node.value)
        if polygon is not None:
            return Fact("footprint", subject, polygon, node.span, "m")
    radius = section.number("robot_radius")
    if radius is not None and radius > 0.0:
        return Fact("footprint", subject, radius, section.values["robot_radius"].span, "m")
    return None


def _polygon(text: str) -> tuple[Point, ...] | None:
    try:
        points = tuple((float(x), float(y)) for x, y in read_json(text))
    except (TypeError, ValueError):
        return None
    is_plain = all(abs(value) < 1e6 for point in points for value in point)
    return points if is_plain and len(points) >= 3 else None


def check_footprints_agree(evidence: facts.Evidence, report: Report) -> None:
    """Reports costmaps of one file with different footprints."""
    by_file: dict[str, Fact] = {}
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


def _shown(fact: Fact) -> str:
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
    description: FileDescription, base: str, fact: Fact
) -> tuple[float, str, PlacedShape] | None:
    """Returns how far a body stands out of a footprint (m; negative: inside), and its shape.

    Only bodies on fixed joints and wheels count: an arm moves.  Meshes are left out.
    """
    poses = description.poses
    if base not in poses:
        return None
    parents = {joint.child: joint for joint in description.joints.values()}
    X_BW = poses[base].inverse()
    best: tuple[float, str, PlacedShape] | None = None
    for name, link in description.links.items():
        if not _is_rigid(name, parents) or name not in poses:
            continue
        for shape in description.shapes(link):
            if not shape.collides:
                continue
            for x, y, _ in corners_of(shape.shape, X_BW * poses[name] * shape.pose):
                distance = _distance(fact, x, y)
                if best is None or distance > best[0]:
                    best = distance, name, shape
    return best


def _is_rigid(name: str, parents: Mapping[str, Joint]) -> bool:
    for _ in range(100):
        joint = parents.get(name)
        if joint is None:
            return True
        if joint.type not in ("fixed", "continuous", "floating"):
            return False
        name = joint.parent
    return False


def _distance(fact: Fact, x: float, y: float) -> float:
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
