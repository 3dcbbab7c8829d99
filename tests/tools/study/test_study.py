"""What a result of a study depends on, and programs that make studies."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import trimesh

from tests.cli.conftest import UNPOWERED
from tests.tools.study.test_studies import DRIVE, ROOT, STUDY, Command, journal_lines, rows, run
from thorvaldc.cli.exits import OutsideError
from thorvaldc.model import Robot
from thorvaldc.tools.study import Study

__all__ = ["run"]
pytestmark = pytest.mark.filterwarnings("ignore")  # of Dask and of the event loop that it leaves

DOCUMENT = {
    "thorvaldc": 1,
    "study": "m",
    "robot": "good.yaml",
    "variables": {"w": {"paths": ["modules.frame.params.width"], "min": "0.8 m", "max": "1.2 m"}},
    "objectives": {"e": {"metric": "measure.e", "goal": "minimise"}},
    "samples": {"method": "grid", "number": 2},
}


def times(robot: Robot, factor: float) -> dict[str, float]:
    return {"e": factor}


class Factor:
    def __init__(self, factor: float) -> None:
        self.factor = factor

    def __call__(self, robot: Robot) -> dict[str, float]:
        return {"e": self.factor}


@pytest.mark.parametrize(
    "function",
    [
        lambda factor: lambda robot: {"e": factor},
        lambda factor: functools.partial(times, factor=factor),
        Factor,
    ],
    ids=["closure", "partial", "object"],
)
def test_another_function_measures_again(run: Command, function: Any) -> None:
    for factor in (2.0, 3.0, 2.0):
        table = Study(DOCUMENT, measure=function(factor)).run("out")
        assert table["e"].tolist() == [factor, factor]
    assert journal_lines("out") == 4


def test_other_files_are_another_study(run: Command) -> None:
    """Scenarios that change places, a mesh, and a file that changes while a study is open."""
    for name, speed in (("slow", 0.1), ("fast", 0.5)):
        Path(f"{name}.yaml").write_text(DRIVE.replace("0.5 m/s", f"{speed} m/s"))
    text = STUDY.replace("light: {fact: mass", "far: {metric: a.path").replace("81", "2")
    text = text.replace("at_least: 50", "at_least: 9")
    places = "scenarios: {a: {scenario: slow.yaml}, b: {scenario: fast.yaml}}\nobjectives:"
    Path("study.yaml").write_text(text.replace("objectives:", places))
    first = Study("study.yaml").run("out")["far"]
    exchanged = places.replace("slow", "x").replace("fast", "slow").replace("x.yaml", "fast.yaml")
    Path("study.yaml").write_text(text.replace("objectives:", exchanged))
    assert (Study("study.yaml").run("out")["far"] > 2.0 * first).all()
    study = Study(DOCUMENT, measure=functools.partial(times, factor=1.0))
    Path("good.yaml").write_text(UNPOWERED + "description: other\n")
    with pytest.raises(OutsideError, match="has changed since the study was read"):
        study.run("out")


@pytest.mark.slow
def test_a_mesh_belongs_to_the_question(run: Command) -> None:
    shutil.copytree(ROOT / "examples/4wd2ws_tall", "tall")
    document = {**DOCUMENT, "robot": "tall/robot.yaml"}
    measure = functools.partial(times, factor=1.0)
    study = Study(document, measure=measure)
    mesh = next(Path("tall").rglob("*.stl"))
    triangles = trimesh.load_mesh(mesh)
    triangles.apply_scale(2.0)
    triangles.export(mesh)
    assert Study(document, measure=measure).plan.question() != study.plan.question()
    with pytest.raises(OutsideError, match=r"the mesh .* has changed since the study was read"):
        study.run("out")


def test_results_of_another_state_of_the_study_are_not_shown(run: Command) -> None:
    text = STUDY.replace("81", "3").replace("at_least: 50", "at_least: 9")
    Path("study.yaml").write_text(text)
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    for old, new in (("min: 0.8", "min: 1.0"), ("minimise", "maximise")):
        Path("study.yaml").write_text(text.replace(old, new))
        assert run("study", "best", "study.yaml", "-o", "best.yaml").status == 3
        result = run("study", "show", "study.yaml")
        assert result.status == 3
        assert "has no results of this state of the study" in result.err


def test_a_function_that_ends_the_program_ends_its_design(run: Command) -> None:
    table = Study(DOCUMENT, measure=lambda robot: sys.exit(3)).run("out")
    assert set(table["message"]) == {"SystemExit: 3"}


@pytest.mark.slow
def test_a_program_that_its_processes_would_run_again(run: Command) -> None:
    Path("main.py").write_text(
        "from thorvaldc.tools.study import Study\n"
        f"study = Study({DOCUMENT!r}, measure=lambda robot: {{'e': 1.0}})\n"
        "study.run('out', jobs=2)\n"
    )
    done = subprocess.run(
        [sys.executable, "main.py"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode != 0
    assert "below `if __name__ == '__main__':`" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_program_finds_the_modules_beside_it(run: Command) -> None:
    Path("folder").mkdir()
    Path("folder/helper_of_the_study.py").write_text("def measure(robot): return {'e': 1.0}\n")
    Path("folder/study.py").write_text(
        "from helper_of_the_study import measure\n"
        "from thorvaldc.tools.study import Study\n"
        f"study = again = Study({DOCUMENT!r}, measure=measure)\n"
    )
    result = run("study", "run", "folder/study.py", "-j", "2", "-o", "out")
    assert result.status == 0, result.err
    assert rows("out", "status, e") == [("ok", 1.0)] * 2
    Path("folder/study.py").write_text("import sys\nsys.exit(2)\n")
    assert "study.py:2: SystemExit" in run("study", "run", "folder/study.py").err


@pytest.mark.parametrize("line", [b'{"a": 1}\n', b"[]\n", b"7\n", b"\xff\n"])
def test_lines_that_are_no_record_are_removed(run: Command, line: bytes) -> None:
    Path("study.yaml").write_text(STUDY.replace("81", "3"))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    whole = Path("out/designs.parquet").read_bytes()
    journal = Path("out/journal.log")
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:3], line, *lines[3:]]))
    assert run("study", "run", "study.yaml", "-j", "1", "-o", "out").status == 0
    assert Path("out/designs.parquet").read_bytes() == whole
