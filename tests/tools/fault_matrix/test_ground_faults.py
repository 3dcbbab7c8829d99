"""Faults of the ground: what the odometry states, and whether the driver warns."""

from __future__ import annotations

import functools
import json
import re

import pytest

import thorvaldc
from tests.cli.conftest import Command
from tests.tools.fault_matrix.fault_table_page import GROUND, PAGE
from tests.tools.fault_matrix.hazard_page import cells
from thorvaldc.model import Robot
from thorvaldc.tools.fault_matrix import ground_faults
from thorvaldc.tools.fault_matrix.ground_faults import GroundRow

pytestmark = pytest.mark.xdist_group("ground_faults")
EXAMPLES = PAGE.parents[1] / "examples"


@functools.cache
def robot(name: str) -> Robot:
    return thorvaldc.load(EXAMPLES / name / "robot.yaml")


@functools.cache
def rows(name: str) -> dict[str, GroundRow]:
    groups = ground_faults.ground_faults(robot(name))
    return {row.fault.name: row for row in ground_faults.ground_rows(robot(name), groups)}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["4wd4ws_wide", "2wd0ws_greenhouse"])
def test_stalled_wheels_are_warned_about_and_within_the_stated_error(name: str) -> None:
    for fault in ("a wheel stalls", "all wheels stall"):
        row = rows(name)[fault]
        assert row.warning.startswith("odometry: ")
        assert row.warned_after is not None
        assert 0.0 < row.warned_after < 2.0
        assert row.deviations < 3.0, row
        assert row.deviation > 1.0


def test_a_held_robot_with_an_imu_is_warned_about() -> None:
    """The wheels spin as commanded.  In the curve, the gyro contradicts them."""
    for fault in ("the robot is held", "held, a wheel on ice", "held, all wheels on ice"):
        row = rows("4wd4ws_wide")[fault]
        assert row.path_odometry > 2.0 * row.path_true
        assert row.deviations < 3.0, row
        assert "the wheels slide" in row.warning


def test_a_robot_that_is_held_does_not_move() -> None:
    """The truth is that of the simulation, and not what wheels say."""
    for row in (rows("2wd0ws_greenhouse")[f] for f in ("the robot is held", "all wheels stall")):
        assert row.path_true < 1.2
    assert rows("2wd0ws_greenhouse")["a wheel stalls"].path_true > 1.5


@pytest.mark.parametrize("name", ["4wd4ws_wide", "2wd0ws_greenhouse"])
def test_the_rows_are_those_of_the_page(name: str) -> None:
    """Numbers may differ by some ticks between processors."""
    number = re.compile(r"[0-9]+\.[0-9]+")
    page = [line[1:] for line in cells(GROUND) if line[0] == name]
    now = [[*ground_faults.ground_cells(row)] for row in rows(name).values()]
    for one, other in zip(now, page, strict=True):
        texts = ["|".join(line) for line in (one, other)]
        assert number.sub("", texts[0]) == number.sub("", texts[1]), "make golden writes it"
        pairs = zip(*map(number.findall, texts), strict=True)
        assert all(abs(float(a) - float(b)) < 0.31 for a, b in pairs), f"{texts} (make golden)"


def test_the_command_prints_them(thorvaldc: Command) -> None:
    file = str(EXAMPLES / "2wd0ws_greenhouse" / "robot.yaml")
    arguments = ("faults", file, "--only", "all wheels stall", "-j", "1")
    status, out, err = thorvaldc(*arguments)
    assert (status, err) == (0, "")
    lines = [line for line in out.splitlines() if line.startswith("|")]
    expected = ground_faults.ground_cells(rows("2wd0ws_greenhouse")["all wheels stall"])
    assert [cell.strip() for cell in lines[-1].split("|")[1:-1]] == [*expected]
    assert "promises are kept" not in out, "nothing was promised, and nothing tried"
    result = json.loads(thorvaldc(*arguments, "--json").out)
    assert result["faults"] == []
    (row,) = result["ground"]
    assert row["fault"] == "all wheels stall"
    assert row["standard_deviation"] > 1.0
    assert row["warning"].startswith("odometry: ")
