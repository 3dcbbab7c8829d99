"""Compiles fleet files.  A fleet file names robot files and the pose of each robot.

The robots of a fleet have different names, and do not overlap.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.compiler.result import Compilation, Compile, SourceFile
from thorvaldc.compiler.source.input_file import DOCUMENTS, report_missing
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section, read_document
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span
from thorvaldc.model import Fleet, Placement, Pose, Robot
from thorvaldc.model.settings import package_name
from thorvaldc.model.statics.occupied_space import footprint
from thorvaldc.model.statics.tip_over import Point, separates


def compile_fleet(source: SourceFile, compile_robot: Compile) -> Compilation:
    """Compiles a fleet file.

    ``compile_robot`` is the function that compiles each robot file of the fleet.
    """
    compilation, report = Compilation.of(source), Report()
    parts: dict[str, Compilation] = {}
    if source.document is not None:
        checked = source.check_shape(source.document)
        document = read_document(checked, "fleet", ValueReader(report))
        fleet = read_fleet(document, source, compile_robot, report, parts)
        compilation.model = replace(
            fleet, name=document["name"], description=document["description"]
        )
    return compilation.complete(source, report, parts)


def read_fleet(
    document: Section,
    source: SourceFile,
    compile_robot: Compile,
    report: Report,
    parts: dict[str, Compilation],
) -> Fleet:
    """Compiles and places the robots in the section ``robots`` of a fleet or scenario document.

    Robots with errors are left out of the returned fleet.  The function adds the compilation of
    each robot file to ``parts``, by the file name in the fleet document.
    """
    placements = Placements(report)
    for name, entry in document["robots"].items():
        file_node = entry.node.get("robot")
        if file_node is None:
            continue
        file_name = str(file_node.value)
        if file_name not in parts:
            robot_source = open_named_file(source, file_node, report)
            if robot_source is None:
                continue
            # A fleet file must not name a fleet file, because the fleet could contain itself.
            if robot_source.kind != "robot":
                report.add(
                    "fleet-in-fleet",
                    f"`{file_name}` is a {robot_source.kind}; a robot is needed",
                    file_node.span,
                )
                continue
            parts[file_name] = compile_robot(robot_source)
        robot = parts[file_name].model
        if isinstance(robot, Robot):
            placements.add(name, entry, robot)
    return Fleet("", "", tuple(placements.placed))


def open_named_file(source: SourceFile, node: Node, report: Report) -> SourceFile | None:
    """Opens a robot file or fleet file that a document names.

    ``node`` is the YAML node with the path of the file, relative to the folder of ``source``.
    Returns ``None`` and reports an error if the file does not exist.
    """
    name = str(node.value)
    path = source.path.parent / name
    if not os.path.isfile(path):
        report_missing("fleet-robot-missing", source.path.parent, node, DOCUMENTS, report)
        return None
    return SourceFile(path, name, source.path.parent)


# -- names, poses and overlaps -----------------------------------------------------------

FAR_APART = 100.0  # Distance (m) in a grid with an invalid spacing: the robots do not overlap.


class _Footprint(NamedTuple):
    """Ground area of a placed robot.

    Attributes
    ----------
    entry : name of the entry of the document that places the robot.
    name : name of the robot.
    x, y : position of the robot (m).
    radius : radius (m) of a circle about the position that contains the outline.
    outline : corners of the footprint in the scene (m), counter-clockwise.
    """

    entry: str
    name: str
    x: float
    y: float
    radius: float
    outline: list[Point]

    def overlaps(self, other: _Footprint) -> bool:
        """Returns whether the areas of two robots overlap, on the ground."""
        distance = math.hypot(self.x - other.x, self.y - other.y)
        return distance < self.radius + other.radius and not any(
            separates(a, b)
            for a, b in ((self.outline, other.outline), (other.outline, self.outline))
        )


class Placements:
    """Collects the robots of a fleet with their names and poses."""

    def __init__(self, report: Report) -> None:
        self.placed: list[Placement] = []
        self._report = report
        self._spans: dict[str, Span] = {}
        self._packages: dict[str, tuple[str, Span]] = {}
        self._footprints: list[_Footprint] = []

    def add(self, entry: str, section: Section, robot: Robot) -> None:
        """Places the robot, or the grid of robots, of an entry of the section `robots`.

        Parameters
        ----------
        entry : name of the entry.
        section : content of the entry.
        robot : model of the robot.
        """
        reported_entries: set[str] = set()
        node = section.node
        for name, pose in self._poses(entry, section):
            first_span = self._spans.setdefault(name, node.where)
            if first_span is not node.where:
                self._report.add(
                    "fleet-name-twice",
                    f"two robots have the name `{name}`",
                    node.where,
                    hint="rename one of the entries",
                    labels=[Label(first_span, FIRST_USE)],
                )
                return
            placement = Placement(name, pose, self._member(name, robot, node))
            area = _footprint(entry, placement, footprint(robot))
            self._check_overlap(area, node.where, reported_entries)
            self.placed.append(placement)

    def _member(self, name: str, robot: Robot, node: Node) -> Robot:
        """Returns the model of a robot with its ROS 2 package in the fleet."""
        package = package_name(f"{robot.ros.package}_{name}")
        first_name, first_span = self._packages.setdefault(package, (name, node.where))
        if first_name != name:
            self._report.add(
                "ros-package-duplicate",
                f"the ROS 2 packages of `{first_name}` and `{name}` have the name `{package}`",
                node.where,
                hint="rename one of the robots of the fleet",
                labels=[Label(first_span, FIRST_USE)],
            )
        return replace(robot, ros=replace(robot.ros, package=package))

    def _poses(self, entry: str, section: Section) -> Iterator[tuple[str, Pose]]:
        """Yields the name and the pose of each robot that an entry of the section `robots` places.

        The robots of a grid are placed one row after another.
        """
        first = section.planar_pose()
        if "grid" not in section:
            yield entry, first
            return
        grid = section["grid"]
        spacing = grid.get("spacing", FAR_APART)
        for k in range(robots_of(section)):
            x, y, z = first.xyz
            row, column = divmod(k, grid["columns"])
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
                    f"`{footprint.name}` stands in `{earlier.name}`",
                    span,
                    hint="widen the grid's `spacing`"
                    if footprint.entry == earlier.entry
                    else "give each robot its own `xyz`",
                )
        self._footprints.append(footprint)


def robots_of(section: Section) -> int:
    """Returns the number of robots that an entry of the section `robots` places."""
    grid = section["grid"]
    return int(grid["rows"] * grid["columns"])


def _footprint(entry: str, placement: Placement, outline: list[Point]) -> _Footprint:
    """Places the footprint of a robot, whose corners in its ``base_link`` are ``outline``."""
    x, y, _ = placement.pose.xyz
    places = (placement.pose.apply((a, b, 0.0)) for a, b in outline)
    corners = [(a, b) for a, b, _ in places]
    radius = max((math.hypot(a - x, b - y) for a, b in corners), default=0.0)
    return _Footprint(entry, placement.name, x, y, radius, corners)
