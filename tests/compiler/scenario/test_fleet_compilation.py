"""Compilation of fleet files: robot files, poses, grids, errors."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.workshop import CART, Workshop
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.model import Fleet


def fleet(workshop: Workshop, robots: str) -> Compilation:
    return compile_file(workshop.write("fleet.yaml", f"thorvaldc: 1\nname: f\nrobots:\n{robots}"))


def test_each_robot_of_a_fleet_has_its_own_namespace(workshop: Workshop) -> None:
    workshop.robot_file(CART, "namespace: own\n", "robots/one.yaml")
    compilation = fleet(
        workshop,
        "  a: {robot: robots/one.yaml}\n"
        "  b: {robot: robots/one.yaml, xyz: [3 m, 0, 0.1], yaw: 450 deg}\n",
    )
    assert isinstance(compilation.model, Fleet), [d.message for d in compilation.report]
    first, second = compilation.model.placements
    assert (first.name, first.robot.namespace, second.robot.namespace) == ("a", "a", "b")
    assert second.pose.xyz == (3.0, 0.0, 0.1)
    assert second.pose.rpy()[2] == pytest.approx(math.pi / 2)
    assert first.robot.links == second.robot.links


def test_errors_of_a_robot_are_reported_once_in_its_file(workshop: Workshop) -> None:
    workshop.robot_file(CART + "    part: {type: t/blok, mount: body.front}", "", "robots/one.yaml")
    compilation = fleet(workshop, "  a: {robot: robots/one.yaml}\n  b: {robot: robots/one.yaml}\n")
    (diagnostic,) = [d for d in compilation.report if d.code.name == "module-type-unknown"]
    assert diagnostic.span is not None
    assert Path(diagnostic.span.file) == workshop.folder / "robots/one.yaml"
    assert compilation.model is None


def test_errors_of_all_robots_of_a_fleet_are_reported(workshop: Workshop) -> None:
    workshop.robot_file(CART + "    part: {type: t/blok, mount: body.front}", "", "robots/one.yaml")
    workshop.robot_file(CART + "    part: {type: t/block}", "", "robots/two.yaml")
    compilation = fleet(
        workshop,
        "  a: {robot: robots/one.yaml}\n  b: {robot: robots/two.yaml}\n  c: {robot: no.yaml}\n",
    )
    names = [d.code.name for d in compilation.report]
    assert {"module-type-unknown", "root-ambiguous", "fleet-robot-missing"} <= set(names)


def test_hash_of_a_fleet_depends_on_its_robots(workshop: Workshop) -> None:
    file = workshop.robot_file(CART, "", "robots/one.yaml")
    first_hash = fleet(workshop, "  a: {robot: robots/one.yaml}\n").source_sha256
    file.write_text(file.read_text(encoding="utf-8") + "# more\n", encoding="utf-8")
    assert fleet(workshop, "  a: {robot: robots/one.yaml}\n").source_sha256 != first_hash


def test_a_grid_places_equal_robots_row_by_row(workshop: Workshop) -> None:
    workshop.robot_file(CART, "", "robots/one.yaml")
    compilation = fleet(
        workshop,
        "  a:\n    robot: robots/one.yaml\n    xyz: [1 m, 2 m, 0]\n    yaw: 90 deg\n"
        "    grid: {rows: 2, columns: 3, spacing: 1500 mm}\n"
        "  b: {robot: robots/one.yaml, xyz: [-5 m, 0, 0], grid: {spacing: 1 m}}\n",
    )
    assert isinstance(compilation.model, Fleet), [d.message for d in compilation.report]
    *grid, alone = compilation.model.placements
    assert [p.name for p in grid] == [f"a_{k}" for k in range(1, 7)]
    assert [p.robot.namespace for p in grid] == [p.name for p in grid]
    assert [p.pose.xyz[:2] for p in grid] == [(x, y) for x in (1.0, 2.5) for y in (2.0, 3.5, 5.0)]
    assert [p.pose.rpy()[2] for p in grid] == pytest.approx([math.pi / 2] * 6)
    assert (alone.name, alone.pose.xyz[0]) == ("b_1", -5.0)


@pytest.mark.parametrize(
    ("other", "overlaps"),
    [
        # The wheels of a cart cover 1.4 m x 0.9 m.
        ("xyz: [6.41 m, -3 m, 0]", False),
        ("xyz: [6.39 m, -3 m, 0]", True),
        ("xyz: [5 m, -2.09 m, 0]", False),
        ("xyz: [5 m, -2.11 m, 0]", True),
        ("xyz: [3.84 m, -3 m, 0], yaw: 90 deg", False),
        ("xyz: [3.86 m, -3 m, 0], yaw: 90 deg", True),
        ("xyz: [6 m, -2 m, 0], yaw: 45 deg", True),
        ("xyz: [6 m, -2 m, 0], yaw: -45 deg", False),
    ],
)
def test_turned_robots_overlap_where_their_wheels_do(
    workshop: Workshop, other: str, overlaps: bool
) -> None:
    workshop.robot_file(CART, "", "robots/one.yaml")
    compilation = fleet(
        workshop,
        "  a: {robot: robots/one.yaml, xyz: [5 m, -3 m, 0]}\n"
        f"  b: {{robot: robots/one.yaml, {other}}}\n",
    )
    assert ("fleet-overlap" in [d.code.name for d in compilation.report]) is overlaps


def test_narrow_grid_is_reported_once(workshop: Workshop) -> None:
    workshop.robot_file(CART, "", "robots/one.yaml")
    compilation = fleet(
        workshop, "  a: {robot: robots/one.yaml, grid: {rows: 3, columns: 3, spacing: 1 mm}}\n"
    )
    messages = [d.message for d in compilation.report if d.code.name == "fleet-overlap"]
    assert messages == ["`a_2` stands in `a_1`"]
    compilation = fleet(workshop, "  a: {robot: robots/one.yaml, grid: {rows: 3, spacing: -1 m}}\n")
    assert [d.code.name for d in compilation.report.errors] == ["out-of-range"]
    assert "fleet-overlap" not in [d.code.name for d in compilation.report]
    compilation = fleet(
        workshop, "  a: {robot: robots/one.yaml, grid: {rows: 1000, spacing: 1 m}}\n"
    )
    assert [d.code.name for d in compilation.report.errors] == ["out-of-range"]


@pytest.mark.parametrize(
    ("named_file", "text", "kind"),
    [
        ("fleet.yaml", "", "fleet"),
        ("other.yaml", "thorvaldc: 1\nname: o\nrobots: {}\n", "fleet"),
        ("run.yaml", "thorvaldc: 1\nscenario: s\nfleet: fleet.yaml\n", "scenario"),
    ],
)
def test_fleet_names_only_robot_files(
    workshop: Workshop, named_file: str, text: str, kind: str
) -> None:
    workshop.write(named_file, text)
    compilation = fleet(workshop, f"  a: {{robot: {named_file}}}\n")
    assert [(d.code.name, d.message) for d in compilation.report.errors] == [
        ("fleet-in-fleet", f"`{named_file}` is a {kind}; a robot is needed")
    ]
