"""Computes the names and poses of the robots of a fleet, and checks that no robots overlap."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.compiler.geometry.wheel_geometry import contact_point
from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.value_reader import ValueReader
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import Placement, Pose, Robot

# Distance (m) of the robots in a grid if the document contains no valid spacing.  The default
# distance is large, so that the robots do not overlap.
DEFAULT_SPACING = 100.0


class _Footprint(NamedTuple):
    """Ground area that the wheels of a placed robot cover.

    Attributes
    ----------
    entry : name of the entry of the document that places the robot.
    name : name of the robot.
    x, y : position of the robot (m).
    radius : radius (m) of a circle about the position that contains all wheels of the robot.
    wheels : contact point (x, y) and half width of each wheel (m).
    """

    entry: str
    name: str
    x: float
    y: float
    radius: float
    wheels: list[tuple[float, float, float]]

    def overlaps(self, other: _Footprint) -> bool:
        """Returns whether the wheels of two robots overlap."""
        distance = math.hypot(self.x - other.x, self.y - other.y)
        return distance < self.radius + other.radius and any(
            math.dist(a[:2], b[:2]) < a[2] + b[2] for a in self.wheels for b in other.wheels
        )


class Placements:
    """Collects the robots of a fleet with their names and poses."""

    def __init__(self, report: Report) -> None:
        self.placed: list[Placement] = []
        self._report = report
        self._quantities = BoundedQuantities(ValueReader(report), report)
        self._spans: dict[str, Span] = {}
        self._footprints: list[_Footprint] = []

    def add(self, entry: str, node: Node, robot: Robot) -> None:
        """Places the robot, or the grid of robots, of an entry of the section `robots`.

        Parameters
        ----------
        entry : name of the entry.
        node : content of the entry.
        robot : model of the robot.
        """
        reported_entries: set[str] = set()
        for name, pose in self._poses(entry, node):
            first_span = self._spans.setdefault(name, node.where)
            if first_span is not node.where:
                self._report.add(
                    "fleet-name-twice",
                    f"two robots have the name `{name}`",
                    node.where,
                    hint="rename one of the entries",
                    labels=[Label(first_span, "first used here")],
                )
                return
            placement = Placement(name, pose, replace(robot, namespace=name))
            self._check_overlap(_footprint(entry, placement), node.where, reported_entries)
            self.placed.append(placement)

    def _poses(self, entry: str, node: Node) -> Iterator[tuple[str, Pose]]:
        """Yields the name and the pose of each robot that an entry of the section `robots` places.

        The robots of a grid are placed one row after another.
        """
        first = self._quantities.planar_pose(node)
        grid = node.get("grid")
        if grid is None:
            yield entry, first
            return
        spacing = self._quantities.positive(grid, "spacing", "length", DEFAULT_SPACING)
        for k in range(robots_of(node)):
            x, y, z = first.xyz
            row, column = divmod(k, _count(grid, "columns"))
            xyz = (x + row * spacing, y + column * spacing, z)
            yield f"{entry}_{k + 1}", replace(first, xyz=xyz).clean()

    def _check_overlap(self, footprint: _Footprint, span: Span, reported_entries: set[str]) -> None:
        """Reports an overlap of a robot with a robot that was placed earlier.

        Each pair of entries in the section `robots` causes at most one diagnostic about overlapping
        robots.
        """
        for earlier in self._footprints:
            if earlier.entry not in reported_entries and footprint.overlaps(earlier):
                reported_entries.add(earlier.entry)
                self._report.add(
                    "fleet-overlap",
                    f"`{footprint.name}` overlaps `{earlier.name}`",
                    span,
                    hint="widen the grid's `spacing`"
                    if footprint.entry == earlier.entry
                    else "give each robot its own `xyz`",
                )
        self._footprints.append(footprint)


def robots_of(node: Node) -> int:
    """Returns the number of robots that an entry of the section `robots` places."""
    grid = node.get("grid")
    return 1 if grid is None else _count(grid, "rows") * _count(grid, "columns")


def _count(grid: Node, key: str) -> int:
    node = grid.get(key)
    return node.value if node is not None and isinstance(node.value, int) else 1


def _footprint(entry: str, placement: Placement) -> _Footprint:
    """Computes the ground area that a placed robot covers."""
    x, y, _ = placement.pose.xyz
    wheels = []
    for wheel in placement.robot.wheels:
        contact = placement.pose.apply((*contact_point(wheel), 0.0))
        wheels.append((contact[0], contact[1], wheel.width / 2))
    radius = max((math.hypot(a - x, b - y) + half for a, b, half in wheels), default=0.0)
    return _Footprint(entry, placement.name, x, y, radius, wheels)
