"""Studies: known answers, the table on one process and on two, and after kills."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import re
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
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.slope import SlopeStatics
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs, robot_text
from thorvaldc.tools.study.design_text import with_replaced_values
from thorvaldc.tools.study.study_definition import designs_of
from thorvaldc.tools.study.study_results import StudyTable, front
from thorvaldc.tools.study.study_run import StudyJournal, StudyRun

ROOT = Path(__file__).parents[3]
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
    return StudyTable.open(Path(folder)).query(f"SELECT {columns} FROM designs ORDER BY sample")[1]


def study_run() -> StudyRun:
    study = thorvaldc.compile("study.yaml").tool_document
    assert study is not None
    text = study.robot.read_text(encoding="utf-8")
    return StudyRun(StudyInputs(study, text, (), trust=False))


def designs(text: str) -> list[tuple[Any, ...]]:
    Path("study.yaml").write_text(text)
    study = thorvaldc.compile("study.yaml").tool_document
    assert study is not None
    return designs_of(study)


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
        path = "modules.frame.params.width"
        Path("good.yaml").write_text(with_replaced_values(robot, [(path, f"{track:g} m")]))
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
    journal = Path("killed/journal.jsonl")
    command = [sys.executable, "-m", "thorvaldc", "study", "run", "study.yaml", "-o", "killed"]
    for lines, jobs in ((2, "1"), (25, "2")):
        with ChildProcess(
            [*command, "-j", jobs],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        ) as process:
            end = time.monotonic() + 300
            while process.poll() is None and time.monotonic() < end:
                if journal.exists() and journal.read_bytes().count(b"\n") >= lines:
                    break
                time.sleep(0.005)
            os.killpg(process.pid, signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        assert lines <= journal.read_bytes().count(b"\n") < 81
        assert not Path("killed/designs.parquet").exists()
        with journal.open("ab") as file:  # an incomplete line
            file.write(journal.read_bytes().splitlines()[0][:40])
    assert run("study", "run", "study.yaml", "-j", "2", "-o", "killed").status == 0
    assert Path("killed/designs.parquet").read_bytes() == Path("whole/designs.parquet").read_bytes()
    keys = [
        json.loads(line[17:])["key"]
        for line in journal.read_bytes().splitlines()
        if line.endswith(b"}")
    ]
    assert len(keys) == len(set(keys)) == 81
    size = journal.stat().st_size
    assert run("study", "run", "study.yaml", "-o", "killed").status == 0
    assert journal.stat().st_size == size


@pytest.mark.slow
def test_a_killed_process_ends_no_study(run: Command) -> None:
    """The operating system may kill a process, for instance when memory is short."""
    Path("study.yaml").write_text(STUDY.replace("number: 81", "number: 21"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "whole").status == 0
    study = study_run()
    journal = StudyJournal(Path("killed"))
    for finished in study.results(journal, 2):
        if finished in (2, 12):
            processes = multiprocessing.active_children()
            if processes:
                processes[finished % len(processes)].kill()
    assert finished == 21
    study.write_table(journal, Path("killed"))
    assert Path("killed/designs.parquet").read_bytes() == Path("whole/designs.parquet").read_bytes()


def test_designs_that_cannot_be_evaluated_are_rows(run: Command) -> None:
    Path("study.yaml").write_text(STUDY.replace("number: 81", "number: 2"))
    study, journal, end = study_run(), StudyJournal(Path("out")), threading.Event()

    def kill_every_process() -> None:
        while not end.wait(0.02):
            for process in multiprocessing.active_children():
                process.kill()

    thread = threading.Thread(target=kill_every_process)
    thread.start()
    try:
        finished = list(study.results(journal, 2))
    finally:
        end.set()
        thread.join()
    assert finished == [0, 1, 2]
    study.write_table(journal, Path("out"))
    message = "the process that evaluated it was killed 3 times"
    assert rows("out", "status, message") == [("error", message)] * 2
    journal.close()
    assert run("study", "run", "study.yaml", "-j", "2", "-o", "out").status == 0  # tries again
    assert {status for (status,) in rows("out", "status")} <= {"ok", "constraint"}


def test_more_designs_repeat_none(run: Command) -> None:
    def study(number: int) -> str:
        return STUDY.replace("grid, number: 81", f"sobol, number: {number}")

    assert designs(study(11))[:5] == designs(study(5))
    Path("study.yaml").write_text(study(5))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    Path("study.yaml").write_text(study(8))
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    assert Path("study/track/journal.jsonl").read_bytes().count(b"\n") == 8
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


def test_the_winning_file_keeps_comments_and_adds_missing_parameters(run: Command) -> None:
    noted = UNPOWERED.replace(", can: 2}", ", can: 2}  # the right")
    Path("good.yaml").write_text("# a note\n" + noted)
    text = STUDY.replace("number: 81", "number: 2").replace("at_least: 50 deg", "at_least: 10 deg")
    text = text.replace(
        "constraints:",
        "  gear:\n    paths: [modules.fl.params.gear_ratio, modules.fr.params.gear_ratio]\n"
        "    values: ['30:1']\nconstraints:",
    )
    Path("study.yaml").write_text(text)
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    assert run("study", "best", "study.yaml", "-o", "best.yaml").status == 0
    written = Path("best.yaml").read_text()
    assert written.startswith("# Design 1 of the study track (study.yaml), best by light;")
    assert "#   track: 0.8 m\n" in written
    assert "# a note\n" in written
    assert "width: 0.8 m}" in written
    assert "can: 2}  # the right\n" in written
    assert written.count("gear_ratio: 30:1") == 2
    assert run("check", "best.yaml").status == 0
    Path("mine.yaml").write_text(UNPOWERED)
    refused = run("study", "best", "study.yaml", "-o", "mine.yaml")
    assert (refused.status, Path("mine.yaml").read_text()) == (3, UNPOWERED)
    assert run("study", "best", "study.yaml", "-o", "best.yaml").status == 0


@pytest.mark.parametrize(
    ("text", "path", "expected"),
    [
        ("a: {b: 1} # c\n", "a.b", "a: {b: 2 m} # c\n"),
        ("a:\n  b: '1'\n", "a.b", "a:\n  b: 2 m\n"),
        ("a: {b: 1}\n", "a.c.d", "a: {c: {d: 2 m}, b: 1}\n"),
        ("é: ü\na: [1, 3]\n", "a.1", "é: ü\na: [1, 2 m]\n"),
    ],
)
def test_values_are_replaced_in_the_text(text: str, path: str, expected: str) -> None:
    assert with_replaced_values(text, [(path, "2 m")]) == expected


def test_the_front_has_the_points_that_none_dominates() -> None:
    points = [(1, 5), (2, 2), (5, 1), (2, 6), (3, 3), (2, 2), (1, 6)]
    assert front(points) == [0, 1, 2, 5]


def edited(change: Callable[[str], str]) -> None:
    Path("study.yaml").write_text(change(STUDY))


def test_wrong_uses_are_one_line(run: Command) -> None:
    edited(lambda text: text.replace("number: 81", "number: 2"))
    assert run("study", "run", "good.yaml").status == 2
    assert run("study", "show", "study.yaml").status == 3
    assert "study run" in run("study", "best", "study.yaml", "-o", "b.yaml").err
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    query = "SELECT count(*) AS n FROM designs"
    assert json.loads(run("study", "show", "study/track", "--json", "--sql", query).out) == [
        {"n": 2}
    ]
    again = run("study", "run", "study.yaml", "-o", "other", "--json")
    assert json.loads(again.out) == json.loads(
        run("study", "show", "study.yaml", "--results", "other", "--json").out
    )
    assert run("study", "show", "other", "--results", "other").status == 2
    for wrong in ("SELECT nothing FROM designs", "COPY designs TO 'x.csv'"):
        result = run("study", "show", "study.yaml", "--sql", wrong)
        assert result.status == 2
        assert "Traceback" not in result.err
    assert not Path("x.csv").exists()
    assert "no objective" in run("study", "best", "study.yaml", "-o", "b", "--by", "lihgt").err
    edited(lambda text: text.replace("mass,", "masss,"))
    result = run("study", "run", "study.yaml")
    assert result.status == 1
    assert "did you mean `mass`?" in result.err
    Path("study/track/designs.parquet").write_bytes(b"PAR1")
    assert run("study", "show", "study/track").status == 3


def test_the_page_shows_the_example() -> None:
    example = ROOT / "examples/studies/track_on_a_slope/study.yaml"
    page = (ROOT / "docs/studies.md").read_text("utf-8")
    shown = re.search(r"```yaml\n(.*?)```", page, re.S)
    assert shown is not None
    expected = yaml.safe_load(example.read_text("utf-8"))
    del expected["description"]
    assert yaml.safe_load(shown[1]) == expected
    study = thorvaldc.compile(example).tool_document
    assert study is not None
    assert len(designs_of(study)) == 32


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
    study = thorvaldc.compile(
        ROOT / "examples/studies/driven_wheels_in_mud/study.yaml"
    ).tool_document
    assert study is not None
    inputs = StudyInputs(study, study.robot.read_text("utf-8"), (), trust=False)
    design = ("none", rear, hopper)
    with unsaved_texts({str(study.robot.resolve()): robot_text(inputs, design).encode()}):
        robot = thorvaldc.load(study.robot)
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
        row = DesignEvaluator(inputs, stack).evaluate(design)
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
