"""Studies: known answers, the table on one process and on two, and after kills."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import re
import runpy
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml

import thorvaldc
from tests.child_process import ChildProcess
from tests.cli.conftest import UNPOWERED, Command
from tests.cli.conftest import thorvaldc as thorvaldc_command
from tests.slow import mostly_slow
from thorvaldc.compiler.scenario.scenario_compilation import metric_units
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.slope import SlopeStatics
from thorvaldc.tools.study.designs import designs_of
from thorvaldc.tools.study.evaluation import DesignEvaluator
from thorvaldc.tools.study.study import Study
from thorvaldc.tools.study.study_results import front, read_table

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.filterwarnings("ignore")  # of Dask and of the event loop that it leaves
run = pytest.fixture(name="run")(thorvaldc_command.__wrapped__)  # type: ignore[attr-defined]

STUDY = """\
thorvaldc: 1
study: track
robot: good.yaml
variables:
  track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}
constraints:
  tip_over: {fact: stability.angles.left, at_least: 50 deg}
objectives:
  light: {fact: mass, goal: minimise}
samples: {method: grid, number: 81}
"""
DRIVE = """\
thorvaldc: 1
scenario: drive
robots: {good: {robot: good.yaml}}
duration: 0.4 s
script: [{at: 0, vx: 0.5 m/s}]
"""


def rows(folder: str, columns: str) -> list[tuple[Any, ...]]:
    """Returns columns of the table of designs; without a value, ``None``."""
    found = read_table(Path(folder))[columns.split(", ")].astype(object)
    return list(found.where(found.notna(), None).itertuples(index=False, name=None))


def journal_lines(folder: str) -> int:
    """Returns the number of finished designs in a journal."""
    journal = Path(folder, "journal.log")
    return journal.read_bytes().count(b'"key":') if journal.exists() else 0


def designs(text: str) -> list[tuple[Any, ...]]:
    Path("study.yaml").write_text(text)
    return designs_of(Study("study.yaml").plan)


def track_at(angle: float) -> float:
    """The track at which the robot tips over at an angle, in closed form.

    tan(angle) = (w / 2) / h(w).  The two cross tubes grow with the track w; their mass of
    2 rho A (w - w0) at the height z of the tubes changes the height h of the centre of mass.
    """
    robot = thorvaldc.load("good.yaml")
    assert isinstance(robot, Robot)
    mass, (_, _, height) = robot.inertial.mass, robot.inertial.com
    per_metre = 2 * 2700 * math.pi * (0.05**2 - 0.04**2) / 4
    tubes = 0.65  # height of the tubes, the default of the drives
    # (w / 2) (M + m (w - 0.9)) = tan(angle) (M h + m z (w - 0.9))
    a = per_metre / 2
    b = (mass - per_metre * 0.9) / 2 - math.tan(angle) * per_metre * tubes
    c = -math.tan(angle) * (mass * height - per_metre * tubes * 0.9)
    return (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)


@pytest.mark.parametrize("method", mostly_slow(["grid, number: 41", "sobol, number: 128"], slow=0))
def test_the_track_of_a_tip_over_angle_is_found(run: Command, method: str) -> None:
    """The lightest robot that tips over at 50 deg is the narrowest one."""
    expected = track_at(math.radians(50))
    assert 0.85 < expected < 1.15
    Path("study.yaml").write_text(STUDY.replace("grid, number: 81", method))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    best = json.loads(run("study", "show", "study.yaml", "--json").out)["best"][0]
    assert best["track"] == pytest.approx(expected, rel=0.01)
    assert run("study", "best", "study.yaml", "-o", "best.yaml").status == 0
    robot = thorvaldc.load("best.yaml")
    assert isinstance(robot, Robot)
    assert dict(robot_facts(robot).stability.angles)["left"] == pytest.approx(
        math.radians(50), rel=0.01
    )


def test_every_design_is_a_row_with_its_status(run: Command) -> None:
    """A design that does not compile, breaks a constraint or falls over ends nothing."""
    Path("drive.yaml").write_text(DRIVE + "expect: {path: {min: 10 m}}\n")
    text = STUDY.replace("min: 0.8 m, max: 1.2 m", "values: [0.5 m, 0.6 m, 0.9 m]")
    text = text.replace(
        "constraints:", "  id: {paths: [modules.fr.can], values: [1, 2]}\nconstraints:"
    )
    text = text.replace("at_least: 50 deg", "at_least: 35 deg")
    text = text.replace("objectives:", "scenarios: {go: {scenario: drive.yaml}}\nobjectives:")
    Path("study.yaml").write_text(text)
    result = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 0
    assert "no design meets every constraint" in result.out
    found = {
        (track, id_): row for track, id_, *row in rows("out", "track, id, status, code, message")
    }
    status, code, message = found[(0.9, 1.0)]
    assert (status, code) == ("error", "TV501")
    assert "both have the id 1" in message
    assert found[(0.5, 2.0)][:2] == ["constraint", ""]
    assert "tip_over is" in found[(0.5, 2.0)][2]
    assert found[(0.9, 2.0)][:2] == ["expectation", "TV820"]
    assert run("study", "best", "study.yaml", "-o", "b.yaml", "--results", "out").status == 1
    assert not Path("b.yaml").exists()


def test_a_broken_constraint_shows_the_fact_as_a_comparison_does(run: Command) -> None:
    Path("study.yaml").write_text(
        STUDY.replace("min: 0.8 m, max: 1.2 m", "values: [0.9 m, 1.1 m]")
        .replace("stability.angles.left, at_least: 50 deg", "size.track, at_least: 1 m")
        .replace("tip_over", "track_width")
    )
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    (message,) = (text for track, text in rows("out", "track, message") if track == 0.9)
    assert message == "track_width is 0.9 m, less than 1 m"
    Path("other.yaml").write_text(Path("good.yaml").read_text().replace("0.9 m", "1 m", 1))
    assert "0.9 m -> 1 m" in " ".join(run("diff", "good.yaml", "other.yaml").out.split())


def test_two_processes_give_the_same_table(run: Command) -> None:
    Path("drive.yaml").write_text(DRIVE)
    text = STUDY.replace("objectives:", "scenarios: {go: {scenario: drive.yaml}}\nobjectives:")
    text = text.replace("light: {fact: mass", "energy: {metric: go.energy")
    Path("study.yaml").write_text(text.replace("grid, number: 81", "random, number: 8, seed: 3"))
    for jobs in "12":
        assert run("study", "run", "study.yaml", "-j", jobs, "-o", jobs).status == 0
    tables = {Path(jobs, "designs.parquet").read_bytes() for jobs in "12"}
    assert len(tables) == 1
    assert all(value > 0 for (value,) in rows("2", "go.energy") if value is not None)


def test_the_metrics_of_a_design_are_those_of_its_scenario(run: Command) -> None:
    """A study leaves out what it does not need; every metric is equal to the last bit."""
    Path("drive.yaml").write_text(
        DRIVE.replace("vx: 0.5 m/s", "vx: 0.5 m/s, vy: 0.2 m/s, wz: 0.4 rad/s").replace(
            "duration: 0.4 s", "duration: 1 s"
        )
        + "noise: {seed: 2, wheel_speed: 0.01 rad/s}\n"
        + "world: {obstacles: {pole: {shape: box, xyz: [1, 0, 0], size: [0.1, 4, 1]}}}\n"
    )
    text = STUDY.replace("objectives:", "scenarios: {go: {scenario: drive.yaml}}\nobjectives:")
    text = text.replace("at_least: 50 deg", "at_least: 35 deg")
    Path("study.yaml").write_text(text.replace("grid, number: 81", "grid, number: 2"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    robot, metrics = Path("good.yaml").read_text(), [f"go.{name}" for name in metric_units()]
    for track, *values in rows("out", ", ".join(["track", *metrics])):
        assert robot.count("width: 0.9 m") == 1
        Path("good.yaml").write_text(robot.replace("width: 0.9 m", f"width: {track:g} m"))
        result = json.loads(run("scenario", "drive.yaml", "--json").out)
        (expected,) = result["metrics"].values()
        assert dict(zip(metrics, values, strict=True)) == {
            f"go.{name}": value for name, value in expected.items()
        }
        assert expected["energy"] > 0.0
        assert expected["collisions"] > 0.0


@pytest.mark.slow
def test_a_killed_study_continues_and_repeats_nothing(run: Command) -> None:
    Path("study.yaml").write_text(STUDY)
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "whole").status == 0
    journal = Path("killed/journal.log")
    command = [sys.executable, "-m", "thorvaldc", "study", "run", "study.yaml", "-o", "killed"]
    for lines, jobs in ((2, "1"), (25, "2")):
        with ChildProcess(
            [*command, "-j", jobs],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        ) as process:
            end = time.monotonic() + 300
            while process.poll() is None and time.monotonic() < end:
                if journal_lines("killed") >= lines:
                    break
                time.sleep(0.005)
            os.killpg(process.pid, signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        assert lines <= journal_lines("killed") < 81
        assert not Path("killed/designs.parquet").exists()
        with journal.open("ab") as file:  # an incomplete line
            file.write(journal.read_bytes().splitlines()[1][:40])
    assert run("study", "run", "study.yaml", "-j", "2", "-o", "killed").status == 0
    assert Path("killed/designs.parquet").read_bytes() == Path("whole/designs.parquet").read_bytes()
    keys = re.findall(rb'"key":"(\w+)"', journal.read_bytes())
    assert len(keys) == len(set(keys)) == 81
    size = journal.stat().st_size
    assert run("study", "run", "study.yaml", "-o", "killed").status == 0
    assert journal.stat().st_size == size


@pytest.mark.slow
def test_a_killed_process_ends_no_study(run: Command) -> None:
    """The operating system may kill a process, for instance when memory is short."""
    Path("study.yaml").write_text(STUDY.replace("number: 81", "number: 21"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "whole").status == 0
    end, killed = threading.Event(), []

    def kill_processes() -> None:
        for lines in (1, 12):
            while journal_lines("killed") < lines and not end.wait(0.005):
                pass
            for process in multiprocessing.active_children()[:1]:
                process.kill()
                killed.append(process)

    thread = threading.Thread(target=kill_processes)
    thread.start()
    try:
        Study("study.yaml").run("killed", jobs=2)
    finally:
        end.set()
        thread.join()
    assert killed
    assert Path("killed/designs.parquet").read_bytes() == Path("whole/designs.parquet").read_bytes()


KILLER = """\
import os
from thorvaldc.tools.study import Study

def measure(robot):
    if robot.name != "good" or os.path.exists("kills") and robot.inertial.mass > %f:
        os._exit(1)
    return {"wheels": len(robot.wheels)}

study = Study("study.yaml", measure=measure)
"""


@pytest.mark.slow
def test_a_design_that_kills_its_process_is_a_row(run: Command) -> None:
    """All other designs have their results, and the next run tries it again."""
    text = STUDY.replace("number: 81", "number: 5").replace("at_least: 50", "at_least: 10")
    text = text.replace("light: {fact: mass", "wheels: {metric: measure.wheels")
    Path("study.yaml").write_text(text)
    heaviest = thorvaldc.load("good.yaml", set={"modules.frame.params.width": "1.15 m"})
    Path("study.py").write_text(KILLER % heaviest.inertial.mass)
    Path("kills").touch()
    assert run("study", "run", "study.py", "-j", "2", "-o", "out").status == 0
    found = rows("out", "track, status, message")
    assert [status for _, status, _ in found] == ["ok"] * 4 + ["error"]
    assert "was killed several times" in found[-1][2]
    Path("kills").unlink()
    assert run("study", "run", "study.py", "-j", "2", "-o", "out").status == 0
    assert {status for (status,) in rows("out", "status")} == {"ok"}


def test_more_designs_repeat_none(run: Command) -> None:
    def study(number: int) -> str:
        return STUDY.replace("grid, number: 81", f"sobol, number: {number}")

    assert designs(study(11))[:5] == designs(study(5))
    Path("study.yaml").write_text(study(5))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    Path("study.yaml").write_text(study(8))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    assert journal_lines("study/track") == 8
    # A changed file of the robot is another study.
    Path("good.yaml").write_text(UNPOWERED + "description: other\n")
    assert run("study", "best", "study.yaml", "-o", "b.yaml").status == 3


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_samples_cover_the_range_and_depend_on_the_seed(run: Command, method: str) -> None:
    text = STUDY.replace("grid, number: 81", f"{method}, number: 32, seed: 1")
    first, again = designs(text), designs(text)
    other = designs(text.replace("seed: 1", "seed: 2"))
    assert first == again != other
    values = [float(str(track).removesuffix(" m")) for (track,) in first]
    assert all(0.8 <= value <= 1.2 for value in values)
    assert {int((value - 0.8) / 0.1) for value in values} >= {0, 1, 2, 3}


def test_a_grid_has_all_combinations(run: Command) -> None:
    text = STUDY.replace("number: 81", "number: 3").replace(
        "constraints:", "  ids: {paths: [modules.fl.can], min: 5, max: 6}\nconstraints:"
    )
    tracks = ["0.8 m", "1.0 m", "1.2 m"]
    assert designs(text) == [(track, number) for track in tracks for number in (5, 6)]


def test_the_winning_file_extends_the_robot_file(run: Command) -> None:
    text = STUDY.replace("number: 81", "number: 2").replace("at_least: 50 deg", "at_least: 10 deg")
    text = text.replace(
        "constraints:",
        "  gear:\n    paths: [modules.fl.params.gear_ratio, modules.fr.params.gear_ratio]\n"
        "    values: ['30:1']\n  id: {paths: [modules.fl.can], values: [1]}\nconstraints:",
    )
    assert "can: 1}" in Path("good.yaml").read_text()
    Path("study.yaml").write_text(text)
    Path("best").mkdir()
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    for _ in range(2):
        assert run("study", "best", "study.yaml", "-o", "best/robot.yaml").status == 0
    written = Path("best/robot.yaml").read_text()
    assert written.startswith("# Design 1 of the study track (study.yaml)\n")
    assert "#   track: 0.8 m\n" in written
    expected = """\
thorvaldc: 1
extends: ../good.yaml
name: track_1
modules.frame.params.width: 0.8 m
modules.fl.params.gear_ratio: 30:1
modules.fr.params.gear_ratio: 30:1
"""
    assert written.partition("in rad.\n")[2] == expected
    checked = run("check", "best/robot.yaml")
    assert checked.status == 0
    assert "best/robot.yaml:" not in checked.out.replace("best/robot.yaml: track_1", "")
    robot = thorvaldc.load("good.yaml", set={"modules.frame.params.width": "0.8 m"})
    assert thorvaldc.load("best/robot.yaml").inertial.mass == robot.inertial.mass
    for mine in (UNPOWERED, f"# Design notes\n{UNPOWERED}"):
        Path("mine.yaml").write_text(mine)
        refused = run("study", "best", "study.yaml", "-o", "mine.yaml")
        assert (refused.status, Path("mine.yaml").read_text()) == (3, mine)
    for output, reason in (
        ("good.yaml", "will not overwrite good.yaml, which is that of the study"),
        ("missing/best.yaml", "there is no folder missing"),
        ("good.yaml/best.yaml", "there is no folder good.yaml"),
    ):
        refused = run("study", "best", "study.yaml", "-o", output)
        assert (refused.status, reason in refused.err) == (3, True), refused.err


def test_a_variable_replaces_one_place_of_an_alias(run: Command) -> None:
    aliased = UNPOWERED.replace("length: 1.1 m, width: 0.9 m", "length: &w 0.9 m, width: *w")
    assert aliased != UNPOWERED
    Path("good.yaml").write_text(aliased)
    text = STUDY.replace("grid, number: 81", "grid, number: 2")
    Path("study.yaml").write_text(text.replace("at_least: 50 deg", "at_least: 10 deg"))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    assert run("study", "best", "study.yaml", "-o", "best.yaml").status == 0
    robot = thorvaldc.load("best.yaml")
    assert isinstance(robot, Robot)
    size = robot_facts(robot).size
    assert (size.wheelbase, size.track) == pytest.approx((0.9, 0.8), abs=1e-9)


def test_the_winning_file_of_a_unit(run: Command) -> None:
    """The unit has an entry of its design; the robot has the name that the winner would have."""
    lines = ["thorvaldc: 1", "extends: good.yaml", "name: track_1", *["# a note"] * 8]
    Path("unit.yaml").write_text("\n".join([*lines, "modules.fl.can: 1", ""]))
    text = STUDY.replace("good.yaml", "unit.yaml").replace("grid, number: 81", "grid, number: 2")
    Path("study.yaml").write_text(text.replace("at_least: 50 deg", "at_least: 10 deg"))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    assert run("study", "best", "study.yaml", "-o", "best.yaml").status == 0
    written = Path("best.yaml").read_text().partition("in rad.\n")[2].splitlines()
    assert written == [
        *lines[:1],
        "extends: unit.yaml",
        lines[2],
        "modules.frame.params.width: 0.8 m",
    ]
    assert run("check", "best.yaml").status == 0


def test_the_front_has_the_points_that_none_dominates() -> None:
    points = [(1, 5), (2, 2), (5, 1), (2, 6), (3, 3), (2, 2), (1, 6)]
    assert front(points) == [0, 1, 2, 5]


def edited(change: Callable[[str], str]) -> None:
    Path("study.yaml").write_text(change(STUDY))


@pytest.mark.slow
def test_wrong_uses_are_one_line(run: Command) -> None:
    edited(lambda text: text.replace("number: 81", "number: 2"))
    assert run("study", "run", "good.yaml").status == 2
    assert run("study", "show", "study.yaml").status == 3
    assert "study run" in run("study", "best", "study.yaml", "-o", "b.yaml").err
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    again = run("study", "run", "study.yaml", "-o", "other", "--json")
    assert json.loads(again.out) == json.loads(
        run("study", "show", "study.yaml", "--results", "other", "--json").out
    )
    result = run("study", "best", "study.yaml", "-o", "b", "--by", "lihgt")
    assert "the objectives are light" in result.err
    edited(lambda text: text.replace("mass,", "masss,"))
    result = run("study", "run", "study.yaml")
    assert result.status == 1
    assert "did you mean `mass`?" in result.err
    Path("study/track/designs.parquet").write_bytes(b"PAR1")
    Path("study.yaml").write_text(STUDY)
    assert run("study", "show", "study.yaml").status == 3


def test_the_page_shows_the_example() -> None:
    example = ROOT / "examples/studies/track_on_a_slope/study.yaml"
    page = (ROOT / "docs/studies.md").read_text("utf-8")
    shown = re.search(r"```yaml\n(.*?)```", page, re.S)
    assert shown is not None
    expected = yaml.safe_load(example.read_text("utf-8"))
    del expected["description"]
    assert yaml.safe_load(shown[1]) == expected
    assert len(Study(example)) == 32


@pytest.mark.slow
def test_the_program_of_the_page_runs(run: Command) -> None:
    """In this process and as an argument of the command, on two processes."""
    page = (ROOT / "docs/studies.md").read_text("utf-8")
    program = re.search(r"```python title=\"turn.py\"\n(.*?)```", page, re.S)
    assert program is not None
    Path("turn.py").write_text(program[1])
    Path("robot.yaml").write_text(UNPOWERED)
    assert run("study", "run", "turn.py", "-j", "2", "-o", "two").status == 0
    found = rows("two", "width, status, error")
    assert [(width, status) for width, status, _ in found] == [
        (width, "ok") for width in (0.8, 0.9, 1.0, 1.1, 1.2)
    ]
    assert all(0.0 < error < 0.05 for _, _, error in found)
    assert run("study", "best", "turn.py", "--results", "two", "-o", "best.yaml").status == 0
    names = runpy.run_path("turn.py")
    table = names["study"].run("one")
    assert Path("one/designs.parquet").read_bytes() == Path("two/designs.parquet").read_bytes()
    best = names["study"].best(table)
    assert best["error"] == min(error for _, _, error in found)
    with pytest.raises(ValueError, match="there are error"):
        names["study"].best(table, "eror")
    assert names["measure"](thorvaldc.load("best.yaml")) == {"error": best["error"]}
    assert len(names["study"].optuna_study("one").trials) == 5
    Path("wrong.py").write_text(program[1].replace('{"error": ', '{"eror": '))
    assert run("study", "run", "wrong.py", "-j", "1", "-o", "wrong").status == 0
    assert set(rows("wrong", "status, message")) == {("error", "the design has no measure.error")}
    Path("broken.py").write_text("import math\nmath.sqrt(-1)\n")
    assert "broken.py:2: ValueError: " in run("study", "run", "broken.py").err


def test_a_variable_of_a_scenario(run: Command) -> None:
    """The friction of the ground is another one in each design; wrong paths have their line."""
    Path("drive.yaml").write_text(DRIVE)
    text = STUDY.replace("objectives:", "scenarios: {go: {scenario: drive.yaml}}\nobjectives:")
    text = re.sub(r"constraints:\n.*\n", "", text)
    text = text.replace("light: {fact: mass", "energy: {metric: go.slip")
    track = "track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}"
    text = text.replace("number: 81", "number: 3")
    Path("study.yaml").write_text(
        text.replace(track, "ground: {paths: [go.world.friction], min: 0.1, max: 0.5}")
    )
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    found = rows("out", "ground, energy")
    assert [ground for ground, _ in found] == [0.1, 0.3, 0.5]
    assert found[0][1] > found[2][1]
    wrong = text.replace(track, "ground: {paths: [go.world.fricton], min: 0.1, max: 0.5}")
    Path("study.yaml").write_text(wrong)
    result = run("check", "study.yaml")
    assert result.status == 1
    assert "study.yaml:5:20: error[TV201]" in result.out
    assert "did you mean `friction`?" in result.out
    robot = "ground: {paths: [go.robots.good.robot], values: [good.yaml]}"
    Path("study.yaml").write_text(text.replace(track, robot))
    assert "changes nothing: a design replaces the robots" in run("check", "study.yaml").out


@pytest.mark.parametrize(
    ("path", "values", "expected"),
    [
        ("modules.frame.params.widht", "min: 0.8 m, max: 1.2 m", "TV311] param-unknown"),
        ("modules.frame.params.width", "values: [0.9 m, 0.9 kg]", "TV211] wrong-dimension"),
        ("modules.fr.type", "values: [assembly/fixd_drive]", "did you mean `assembly/fixed_drive`"),
        ("modules.frame.params", "values: [1 m]", "TV203] wrong-type"),
        ("modules.frme.params.width", "values: [1 m]", "TV202] missing-key"),
        ("driver.rat", "values: [50 Hz]", "did you mean `rate`?"),
    ],
)
def test_wrong_paths_and_values_have_their_line(
    run: Command, path: str, values: str, expected: str
) -> None:
    old = "paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m"
    Path("study.yaml").write_text(STUDY.replace(old, f"paths: [{path}], {values}"))
    result = run("check", "study.yaml")
    assert result.status == 1
    error = result.out[result.out.index("study.yaml:5:") :]
    assert expected in error


@pytest.mark.parametrize(
    ("path", "values", "message"),
    [
        (
            "go.world.friction",
            "[0.5]",
            "`go` is neither a section of the robot file",
        ),
        ("module.frame.params.length", "[1 m]", "did you mean `modules.frame.params.length`?"),
        ("modules.frame.params.width", "[-1 m]", "TV313] param-range"),
    ],
)
def test_paths_that_replace_no_place_of_their_own(
    run: Command, path: str, values: str, message: str
) -> None:
    Path("good.yaml").write_text(UNPOWERED)
    old = "paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m"
    Path("study.yaml").write_text(STUDY.replace(old, f"paths: [{path}], values: {values}"))
    result = run("check", "study.yaml")
    assert result.status == 1
    assert message in result.out
    twice = f"  again: {{{old}}}\nconstraints:"
    Path("study.yaml").write_text(STUDY.replace("constraints:", twice))
    assert "is also a path of `track`" in run("check", "study.yaml").out


@pytest.mark.parametrize(
    ("rear", "hopper", "status"),
    [
        ("caster/fixed", "-0.3 m", "expectation"),
        ("caster/fixed", "0.15 m", "ok"),
        ("assembly/steered_drive", "0.0 m", "ok"),
    ],
)
def test_a_robot_climbs_in_mud_if_its_grip_suffices(rear: str, hopper: str, status: str) -> None:
    """The margins of the example's page: grip over weight downhill and rolling resistance."""
    plan = Study(ROOT / "examples/studies/driven_wheels_in_mud/study.yaml").plan
    design = ("none", rear, hopper)
    robot = thorvaldc.load(plan.robot, set=plan.changes(design))
    assert isinstance(robot, Robot)
    angle = math.radians(6)
    loads = list(zip(robot.wheels, SlopeStatics(robot).loads(angle), strict=True))
    downhill = robot.inertial.mass * GRAVITY * math.sin(angle)
    margins = [
        friction
        * math.fsum(load for wheel, load in loads if wheel.driven)
        / (downhill + resistance * math.fsum(load for wheel, load in loads if not wheel.driven))
        for friction, resistance in ((0.45, 0.2), (0.4, 0.25))
    ]
    with ExitStack() as stack:
        row = DesignEvaluator(plan, None, stack).evaluate(design)
    assert row["status"] == status, row["message"]
    assert (min(margins) > 1.0) == (status == "ok")
    assert row["facts"]["purchase.price"] == (19200.0 if "steered" in rear else 11800.0)
    energy = row["metrics"]["mud"]["energy_per_metre"]
    assert energy == row["metrics"]["mud"]["energy"] / row["metrics"]["mud"]["path"]


def test_a_hopeless_run_ends_early(run: Command) -> None:
    drive = DRIVE.replace("0.4 s", "20 s")
    Path("drive.yaml").write_text(f"{drive}expect: {{path: {{max: 0.3 m}}}}\n")
    scenario = "scenarios: {trip: {scenario: drive.yaml}}\n"
    Path("study.yaml").write_text(
        STUDY.replace("objectives:", f"{scenario}objectives:").replace("81", "2")
    )
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    found = rows("out", "status, message")
    assert [status for status, _ in found if status != "constraint"] == ["expectation"]
    message = next(message for status, message in found if status == "expectation")
    pattern = r"`path` of good is 0.3\d* m after (\d\.\d\d) s; at most 0.3 m is expected"
    match = re.fullmatch(pattern, message)
    assert match is not None, message
    assert float(match[1]) < 2.0
