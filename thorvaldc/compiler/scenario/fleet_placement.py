"""Where the robots of a fleet stand, and what they are called."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.compiler.geometry.wheel_geometry import contact_point
from thorvaldc.compiler.library import Library
from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import Placement, Pose, Robot


class _Stand(NamedTuple):
    """What a placed robot takes up: a circle about its wheels, and each wheel's half width, m."""

    entry: str
    name: str
    x: float
    y: float
    reach: float
    wheels: list[tuple[float, float, float]]


class Placements:
    """The robots of a scene, entry by entry of the document."""

    def __init__(self, report: Report) -> None:
        self.placed: list[Placement] = []
        self._report = report
        self._scope = Scope(None, {}, Library(), report, None)
        self._spans: dict[str, Span] = {}
        self._stands: list[_Stand] = []

    def add(self, entry: str, node: Node, robot: Robot) -> None:
        """Place the robot of an entry, or those of its grid."""
        told: set[str] = set()
        for name, pose in self._places(entry, node):
            known = self._spans.setdefault(name, node.where)
            if known is not node.where:
                self._report.add(
                    "fleet-name-twice",
                    f"two robots have the name `{name}`",
                    node.where,
                    hint="rename one of the entries",
                    labels=[Label(known, "first used here")],
                )
                return
            placement = Placement(name, pose, replace(robot, namespace=name))
            self._check_apart(_stand(entry, placement), node.where, told)
            self.placed.append(placement)

    def _places(self, entry: str, node: Node) -> Iterator[tuple[str, Pose]]:
        first = self._pose(node)
        grid = node.get("grid")
        if grid is None:
            yield entry, first
            return
        spacing = BoundedQuantities(self._scope, self._report).positive(
            grid, "spacing", "length", 100.0
        )
        for k in range(robots_of(node)):
            x, y, z = first.xyz
            row, column = divmod(k, _count(grid, "columns"))
            xyz = (x + row * spacing, y + column * spacing, z)
            yield f"{entry}_{k + 1}", replace(first, xyz=xyz).clean()

    def _pose(self, node: Node) -> Pose:
        yaw = math.remainder(self._scope.quantity(node.get("yaw"), "angle"), 2 * math.pi)
        xyz = self._scope.vector(node.get("xyz"), "length")
        return Pose.from_xyz_rpy(xyz, (0.0, 0.0, yaw)).clean()

    def _check_apart(self, own: _Stand, span: Span, told: set[str]) -> None:
        """Whether it has a wheel where another robot has one; said once of two entries."""
        for other in self._stands:
            if (
                math.hypot(own.x - other.x, own.y - other.y) < own.reach + other.reach
                and other.entry not in told
                and any(
                    math.dist(a[:2], b[:2]) < a[2] + b[2] for a in own.wheels for b in other.wheels
                )
            ):
                told.add(other.entry)
                self._report.add(
                    "fleet-overlap",
                    f"`{own.name}` stands where `{other.name}` stands",
                    span,
                    hint="widen the grid's `spacing`"
                    if own.entry == other.entry
                    else "give each robot its own `xyz`",
                )
        self._stands.append(own)


def robots_of(node: Node) -> int:
    """The number of robots of an entry."""
    grid = node.get("grid")
    return 1 if grid is None else _count(grid, "rows") * _count(grid, "columns")


def _count(grid: Node, key: str) -> int:
    node = grid.get(key)
    return node.value if node is not None and isinstance(node.value, int) else 1


def _stand(entry: str, placement: Placement) -> _Stand:
    x, y, _ = placement.pose.xyz
    wheels = []
    for wheel in placement.robot.wheels:
        there = placement.pose.apply((*contact_point(wheel), 0.0))
        wheels.append((there[0], there[1], wheel.width / 2))
    reach = max((math.hypot(a - x, b - y) + half for a, b, half in wheels), default=0.0)
    return _Stand(entry, placement.name, x, y, reach, wheels)
