"""Designs per second of a study, beside a plain loop over compile and simulation.

The loop writes the robot file of each design, compiles the scenario and drives it, in one process.
The study evaluates the same designs in turns with the loop, and then on two processes.  All metrics
must be equal to the last bit.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TypeVar

import thorvaldc
from bench.figure import ROOT, Figure
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.tools.study.design_evaluation import DesignEvaluator, StudyInputs, robot_text
from thorvaldc.tools.study.study_definition import Design, Study
from thorvaldc.tools.study.study_run import StudyJournal, StudyRun

Result = TypeVar("Result")
EXAMPLES = ROOT / "examples"
SECONDS = 10.0
DESIGNS = 64
PROCESSES = 2
DEMANDED_MEMORY = 1500.0


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        study = example_study(folder, DESIGNS)
        inputs = StudyInputs(study, study.robot.read_text(encoding="utf-8"), (), trust=False)
        run = StudyRun(inputs)
        evaluator = DesignEvaluator(inputs, stack)
        whole, plain = _Times(), _Times()
        _drive(inputs, run.designs[0])  # loads the library and MuJoCo
        results = []
        for design in run.designs:
            results.append(whole.measure(lambda: evaluator.evaluate(design)))  # noqa: B023
            metrics = plain.measure(lambda: _drive(inputs, design))  # noqa: B023
            if results[-1]["metrics"] != {"traverse": metrics}:
                raise SystemExit("the study and the loop have other metrics")
        parallel = _Times()
        with closing(StudyJournal(folder / "results")) as journal:
            parallel.measure(lambda: list(run.results(journal, PROCESSES)))
            if [journal.results[key] for key in run.keys] != results:
                raise SystemExit("the study has other results on several processes")
    simulated = SECONDS * len(results)
    yield Figure(
        "a study on two processes",
        plain.wall / parallel.wall,
        "",
        None,
        "higher",
        "robot-seconds per second, relative to a loop over compile and simulation in one process:"
        f" {simulated / parallel.wall:.0f}, loop {simulated / plain.wall:.0f},"
        f" study on one process {simulated / whole.wall:.0f};"
        f" {len(results)} designs of {SECONDS:g} s, with the start of the processes",
    )
    yield Figure.ratio(
        "a study per processor",
        1.0,
        zip(plain.processor, whole.processor, strict=True),
        "robot-seconds per second of processor time, relative to the loop, in turns in one process:"
        f" {simulated / sum(whole.processor):.0f}, loop {simulated / sum(plain.processor):.0f}",
        better="higher",
    )
    own, child = (
        resource.getrusage(who).ru_maxrss / 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    yield Figure(
        "memory of a study",
        own + PROCESSES * child,
        "MB",
        DEMANDED_MEMORY,
        "lower",
        "peak resident sets: main process, and twice the largest of its two processes",
    )


class _Times:
    """Sum of the wall times, and the processor times (s), of calls in this process."""

    def __init__(self) -> None:
        self.wall, self.processor = 0.0, list[float]()

    def measure(self, function: Callable[[], Result]) -> Result:
        wall, processor = time.perf_counter(), time.process_time()
        result = function()
        self.wall += time.perf_counter() - wall
        self.processor.append(time.process_time() - processor)
        return result


def example_study(folder: Path, designs: int) -> Study:
    """Returns the example of the documentation with scenarios of 10 s."""
    robot, name = "4wd4ws_slim", "track_on_a_slope"
    shutil.copytree(EXAMPLES / robot, folder / robot)
    shutil.copytree(EXAMPLES / "studies" / name, folder / "studies" / name)
    path = folder / "studies" / name
    _replace(path / "traverse.yaml", "duration: 3 s", f"duration: {SECONDS:g} s")
    _replace(path / "traverse.yaml", "at: 2.6 s", f"at: {SECONDS - 0.4:g} s")
    _replace(path / "study.yaml", "at_most: 1.4 m", "at_most: 2 m")  # every design is driven
    _replace(path / "study.yaml", "number: 32", f"number: {designs}")
    study = thorvaldc.compile(path / "study.yaml").tool_document
    if study is None:
        raise SystemExit("the example does not compile")
    return study


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    if old not in text:
        raise SystemExit(f"{path.name} has no {old!r}")
    path.write_text(text.replace(old, new), encoding="utf-8")


def _drive(inputs: StudyInputs, design: Design) -> dict[str, float]:
    study = inputs.study
    study.robot.write_text(robot_text(inputs, design), encoding="utf-8")
    ((_, scenario_file),) = study.scenarios
    scenario = thorvaldc.compile(scenario_file).scenario
    if scenario is None:
        raise SystemExit("a design does not compile")
    files = thorvaldc.emit(scenario.fleet, ["mjcf"])
    (metrics,) = ScenarioSimulation(scenario, files).play(Report()).metrics.values()
    return dict(metrics)
