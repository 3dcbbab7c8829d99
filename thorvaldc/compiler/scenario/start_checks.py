"""Checks that no robot of a scenario starts inside an obstacle.

A robot and an obstacle overlap if their outlines from above overlap, at a height that both have.
The outline of the robot consists of the convex outlines of its collision shapes and wheels, so that
a tall robot may start above a row of plants.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Proposal, Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Block, Box, Cylinder, Fleet, Placement, Pose, Shape, Sphere, Vec3
from thorvaldc.model.statics.convex_hull import Point, convex_hull, overlap
from thorvaldc.model.statics.joint_tree import tree_of

_CORNERS = 16  # of the polygon that stands for a circle
_TOLERANCE = 0.01  # Overlap (m) that is not reported: the outline of a circle is not exact.
_CARRYING = ("kerb", "rail")  # kinds of blocks on which wheels may stand
_SECTIONS = {"crop": "crop_rows", "post": "polytunnels"}


class _Solid(NamedTuple):
    """Points (m) of a convex body in the world, and its lowest and highest point (m)."""

    points: list[Vec3]
    bottom: float
    top: float

    def outline(self, height: float = math.inf) -> list[Point]:
        """Returns the outline from above of the points that are not higher than ``height``."""
        return convex_hull([(x, y) for x, y, z in self.points if z <= height])

    def misses(self, least_x: float, most_x: float, least_y: float, most_y: float) -> bool:
        """Returns whether the body is outside of a rectangle on the ground."""
        xs, ys = [x for x, _, _ in self.points], [y for _, y, _ in self.points]
        return max(xs) < least_x or min(xs) > most_x or max(ys) < least_y or min(ys) > most_y


def check_obstacles(fleet: Fleet, world: Section, report: Report) -> None:
    """Reports each robot that starts inside an obstacle, a plant or a post."""
    blocks = [
        (block, _solid(block.shape, block.pose))
        for block in (fleet.world.blocks if fleet.world is not None else ())
        if block.kind not in _CARRYING
    ]
    if not blocks:
        return
    for placement in fleet.placements:
        parts = list(_parts(placement))
        if not parts:
            continue
        xs, ys = zip(*((x, y) for part in parts for x, y, _ in part.points), strict=True)
        reach = min(xs), max(xs), min(ys), max(ys)
        reported: set[int] = set()
        for block, solid in blocks:
            node = _node(block, world.node)
            if node is None or solid is None or id(node) in reported or solid.misses(*reach):
                continue
            moves = [
                move
                for part in parts
                if part.bottom < solid.top - _TOLERANCE
                and solid.bottom < part.top - _TOLERANCE
                and (move := overlap(part.outline(solid.top), solid.outline())) is not None
            ]
            depth, direction = max(moves, default=(0.0, (1.0, 0.0)))
            if depth > _TOLERANCE:
                reported.add(id(node))
                _report(placement, block, node, depth, direction, report)


def _report(
    placement: Placement,
    block: Block,
    node: Node,
    depth: float,
    direction: Point,
    report: Report,
) -> None:
    what = {"crop": "a plant", "post": "a post"}.get(block.kind, f"the obstacle `{block.name}`")
    hint = "start the robot beside it"
    position = node.get("xyz")
    if block.kind == "obstacle" and position is not None:
        x, y, z = block.pose.xyz[0], block.pose.xyz[1], 0.0
        distance = depth + 0.5
        moved = ", ".join(
            f"{plain(round(value, 2))} m"
            for value in (x + distance * direction[0], y + distance * direction[1], z)
        )
        hint = Proposal(
            f"move one of them, for example the obstacle to `[{moved}]`",
            f"[{moved}]",
            span=position.span,
            is_example=True,
        )
    report.add(
        "start-in-obstacle",
        f"`{placement.name}` starts {depth:.2f} m inside {what}",
        node.where,
        hint=hint,
    )


def _node(block: Block, world: Node) -> Node | None:
    """Returns the YAML node of a block."""
    if block.kind == "obstacle":
        return entries(world.get("obstacles")).get(block.name)
    nodes = items(world.get(_SECTIONS.get(block.kind, block.kind)))
    number = int(block.name.partition("_")[0])
    return nodes[number - 1] if number <= len(nodes) else None


def _parts(placement: Placement) -> Iterator[_Solid]:
    """Yields the collision shapes of a placed robot in the world, with all joints at zero."""
    robot = placement.robot
    poses = tree_of(robot).pose
    for link in robot.links:
        for collision in link.collisions:
            if link.name in poses:
                solid = _solid(collision.shape, placement.pose * poses[link.name] * collision.pose)
                if solid is not None:
                    yield solid


def _solid(shape: Shape, pose: Pose) -> _Solid | None:
    """Returns the points of a shape in the world, or ``None`` for a mesh."""
    points = [pose.apply(point) for point in _points(shape)]
    if not points:
        return None
    heights = [z for _, _, z in points]
    return _Solid(points, min(heights), max(heights))


def _points(shape: Shape) -> list[Vec3]:
    """Returns points of a shape, whose convex hull is nearly the shape.

    A sphere is replaced by the largest cylinder in it.
    """
    if isinstance(shape, Box):
        x, y, z = (edge / 2 for edge in shape.size)
        return [(a * x, b * y, c * z) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    circle = [
        (math.cos(2 * math.pi * i / _CORNERS), math.sin(2 * math.pi * i / _CORNERS))
        for i in range(_CORNERS)
    ]
    if isinstance(shape, Cylinder):
        r, half = shape.radius, shape.length / 2
    elif isinstance(shape, Sphere):
        r = half = shape.radius / math.sqrt(2)
    else:
        return []
    return [(r * c, r * s, end * half) for c, s in circle for end in (-1, 1)]
