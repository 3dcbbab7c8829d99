"""Rules about the footprint of Nav2: it covers the collision shapes, and is the same everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.foreign_json import read_json
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Pose
from thorvaldc.model.statics.convex_hull import convex_hull
from thorvaldc.tools.audit.audit_facts import (
    BodyJoint,
    Description,
    Evidence,
    Fact,
    ParameterSection,
    SolidShape,
)

# A footprint may leave out screws and round corners.
TOLERANCE = 0.02  # m

Point = tuple[float, float]


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
        points = read_json(text)
    except ValueError:
        return None
    if not isinstance(points, list) or len(points) < 3:
        return None
    polygon: list[Point] = []
    for point in points:
        if not isinstance(point, list) or len(point) != 2:
            return None
        if not all(isinstance(v, int | float) and abs(v) < 1e6 for v in point):
            return None
        polygon.append((float(point[0]), float(point[1])))
    return tuple(polygon)


def check_footprints_agree(evidence: Evidence, report: Report) -> None:
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


def check_footprints_cover(evidence: Evidence, report: Report) -> None:
    """Reports footprints that leave out a part of the collision shapes."""
    for section in evidence.sections:
        fact = footprint_of(section)
        if fact is None:
            continue
        padding = section.number("footprint_padding")
        margin = TOLERANCE + (padding if padding is not None else 0.01)
        base = (section.text("robot_base_frame") or "base_link").strip("/")
        outside = []
        for description in evidence.related(fact.span.file):
            part = farthest_outside(description, base, fact)
            outside.append(part)
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
    description: Description, base: str, fact: Fact
) -> tuple[float, str, SolidShape] | None:
    """Returns how far a body stands out of a footprint (m; negative: inside), and its shape.

    Only bodies on fixed joints and wheels count: an arm moves.  Meshes are left out.
    """
    poses = description.root_poses()
    if base not in poses:
        return None
    parents = {joint.child: joint for joint in description.joints.values()}
    X_BW = poses[base].inverse()
    best: tuple[float, str, SolidShape] | None = None
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


def _is_rigid(name: str, parents: Mapping[str, BodyJoint]) -> bool:
    for _ in range(100):
        joint = parents.get(name)
        if joint is None:
            return True
        if joint.kind not in ("fixed", "continuous", "free"):
            return False
        name = joint.parent
    return False


def _outline(shape: SolidShape, X_BL: Pose) -> list[Point]:
    """Returns points of a shape that stand out farthest, in the frame of the robot."""
    pose = X_BL * shape.pose
    size = shape.size
    if shape.kind == "box":
        corners = [
            (i * size[0] / 2, j * size[1] / 2, k * size[2] / 2)
            for i in (-1, 1)
            for j in (-1, 1)
            for k in (-1, 1)
        ]
        return [pose.apply(corner)[:2] for corner in corners]
    if shape.kind == "sphere":
        x, y, _ = pose.xyz
        return [(x + size[0] * c, y + size[0] * s) for c, s in _CIRCLE]
    if shape.kind in ("cylinder", "tyre"):
        ends = [(size[0] * c, size[0] * s, z * size[1] / 2) for c, s in _CIRCLE for z in (-1, 1)]
        return [pose.apply(end)[:2] for end in ends]
    return []


_CIRCLE = [(math.cos(i * math.pi / 12), math.sin(i * math.pi / 12)) for i in range(24)]


def _distance(fact: Fact, x: float, y: float) -> float:
    """Returns the distance of a point from a footprint in m, negative inside."""
    if not isinstance(fact.value, tuple):
        return math.hypot(x, y) - float(fact.value)
    return _polygon_distance(convex_hull(fact.value), x, y)


def _polygon_distance(hull: Sequence[Point], x: float, y: float) -> float:
    """Returns the distance of a point from a convex polygon (counter-clockwise) in m."""
    if len(hull) < 3:
        return math.inf
    outside = -math.inf
    for (ax, ay), (bx, by) in zip(hull, (*hull[1:], hull[0]), strict=True):
        length = math.hypot(bx - ax, by - ay)
        if length > 0.0:
            cross = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / length
            outside = max(outside, -cross)
    return outside
