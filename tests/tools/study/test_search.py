"""Searches: known optima, the front beside random designs, and the same designs after a stop."""

from __future__ import annotations

import math
import statistics
from pathlib import Path
from typing import Any

import pytest

import thorvaldc
from tests.cli.conftest import UNPOWERED
from tests.tools.study.test_studies import Command, journal_lines, rows, run
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.tools.study.study_results import read_table

__all__ = ["run"]
pytestmark = pytest.mark.filterwarnings("ignore")  # of Dask and of the event loop that it leaves

SEARCH = """\
thorvaldc: 1
study: search
robot: good.yaml
variables:
  track: {paths: [modules.frame.params.width], min: 0.7 m, max: 1.6 m}
  length: {paths: [modules.frame.params.length], min: 0.9 m, max: 1.6 m}
constraints:
  row: {fact: size.width, at_most: 1.3 m}
objectives:
  stability: {fact: stability.angles.left, goal: maximise}
  mass: {fact: mass, goal: minimise}
samples: {method: search, number: 64, seed: 3}
"""


def write_study(text: str, *changes: tuple[str, str]) -> None:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    Path("study.yaml").write_text(text)


def one_objective(text: str) -> str:
    return text.replace("  mass: {fact: mass, goal: minimise}\n", "")


@pytest.mark.slow
def test_the_widest_robot_that_fits_is_found(run: Command) -> None:
    """The robot is as much wider than its track as its wheels and legs; the best track is that of
    the bound."""
    robot = thorvaldc.compile("good.yaml").model
    assert isinstance(robot, Robot)
    facts = robot_facts(robot)
    assert facts.size.track is not None
    best = 1.3 - (facts.size.width - facts.size.track)
    write_study(one_objective(SEARCH))
    assert run("study", "run", "study.yaml", "-j", "2", "-o", "out").status == 0
    found = [row for row in rows("out", "track, stability, status") if row[2] == "ok"]
    track, stability, _ = max(found, key=lambda row: row[1])
    assert track == pytest.approx(best, rel=0.01)
    # The robot tips over the line of its wheels: tan(angle) = half the track / height of the mass.
    height = facts.size.track / 2.0 / math.tan(dict(facts.stability.angles)["left"])
    assert stability == pytest.approx(math.atan(track / 2.0 / height), rel=0.02)


BATTERY = """\
  battery:
    type: battery/enclosure
    mount: {parent: frame, xyz: [0 mm, 0 mm, 300 mm], rpy: [0, 0, 0]}
    can: 1
"""
PLACE = """\
  ahead: {paths: [modules.battery.mount.xyz.0], min: -300 mm, max: 300 mm}
  left: {paths: [modules.battery.mount.xyz.1], min: -300 mm, max: 300 mm}
  up: {paths: [modules.battery.mount.xyz.2], min: 100 mm, max: 600 mm}
"""


def dominated_area(folder: str) -> float:
    """Returns the area between the front and a robot of 180 kg that tips over at 20 deg."""
    table = read_table(Path(folder)).query("status == 'ok'").sort_values(["mass", "stability"])
    found = [(mass, -stability) for mass, stability in table[["mass", "stability"]].to_numpy()]
    area, least = 0.0, -math.radians(20.0)
    for mass, value in found:
        if value < least:
            area += max(180.0 - mass, 0.0) * (least - value)
            least = value
    return area


@pytest.mark.slow
def test_the_front_dominates_that_of_random_designs(run: Command) -> None:
    Path("good.yaml").write_text(UNPOWERED + BATTERY)
    text = SEARCH.replace("constraints:", f"{PLACE}constraints:")
    text = text.replace("stability.angles.left", "stability.least.angle")
    write_study(text)
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "search").status == 0
    areas = []
    for seed in (1, 2, 3):
        method = f"method: random, number: 64, seed: {seed}"
        write_study(text, ("method: search, number: 64, seed: 3", method))
        assert run("study", "run", "study.yaml", "-j", "1", "-o", f"random{seed}").status == 0
        areas.append(dominated_area(f"random{seed}"))
    assert dominated_area("search") > max(*areas, 1.05 * statistics.fmean(areas))


@pytest.mark.slow
def test_a_stopped_search_goes_on_with_the_same_designs(run: Command) -> None:
    write_study(SEARCH, ("number: 64", "number: 24"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "whole").status == 0
    expected = Path("whole/designs.parquet").read_bytes()
    assert run("study", "run", "study.yaml", "-j", "2", "-o", "two").status == 0
    assert Path("two/designs.parquet").read_bytes() == expected
    journal = Path("stopped/journal.log")
    journal.parent.mkdir()
    lines = Path("whole/journal.log").read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:-6]) + lines[-6][:100])
    assert journal_lines("stopped") == 18
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "stopped").status == 0
    assert Path("stopped/designs.parquet").read_bytes() == expected
    assert journal_lines("stopped") == 24
    assert run("study", "best", "study.yaml", "--by", "mass", "--results", "two", "-o", "b.yaml")
    assert "of the study search" in Path("b.yaml").read_text()


@pytest.mark.slow
def test_more_designs_continue_a_search(run: Command) -> None:
    write_study(SEARCH, ("number: 64", "number: 20"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    few = rows("out", "key")
    write_study(SEARCH, ("number: 64", "number: 28"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    assert rows("out", "key")[:20] == few
    assert len(rows("out", "key")) == 28


@pytest.mark.slow
def test_without_a_scheduler_the_table_stays_whole(run: Command) -> None:
    write_study(SEARCH, ("number: 64", "number: 20"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    expected = Path("out/designs.parquet").read_bytes()
    command = ("study", "run", "study.yaml", "-o", "out", "--scheduler", "tcp://127.0.0.1:9")
    assert run(*command).status == 0  # nothing is left to do
    write_study(SEARCH, ("number: 64", "number: 24"))
    result = run(*command)
    assert result.status == 3
    assert "there is no Dask scheduler at tcp://127.0.0.1:9" in result.err
    assert Path("out/designs.parquet").read_bytes() == expected


@pytest.mark.slow
def test_listed_values_and_failing_designs(run: Command) -> None:
    types = "values: [assembly/steered_drive, assembly/fixed_drive]"
    write_study(
        one_objective(SEARCH),
        ("number: 64", "number: 48"),
        ("constraints:", f"  rear: {{paths: [modules.rl.type], {types}}}\nconstraints:"),
    )
    result = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 0, result.err
    found = rows("out", "rear, status")
    failed = [number for number, (_, status) in enumerate(found) if status == "error"]
    if failed:  # the search avoids what fails
        first = sum(1 for number in failed if number < 16) / 16
        assert sum(1 for number in failed if number >= 16) / 32 < first


@pytest.mark.parametrize(
    ("samples", "text"),
    [
        ("method: search, number: 5001", "with `search` it may have 5000"),
        ("method: saltelli, number: 26000", "with `saltelli` it may have 100000"),
        ("method: search, number: 8, batch: 0", "batch"),
    ],
)
def test_numbers_that_no_method_has(run: Command, samples: str, text: str) -> None:
    write_study(SEARCH, ("method: search, number: 64, seed: 3", samples))
    result = run("check", "study.yaml")
    assert result.status == 1
    assert text in result.out


def test_without_optuna(run: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "optuna", None)
    write_study(SEARCH)
    result: Any = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 3
    assert "this study needs optuna" in result.err
    assert install_command("study") in result.err
