"""Designs per second of a study, beside a plain loop over compile and simulation.

The loop compiles each design with ``set=`` and drives it, in one process.  The study evaluates the
same designs in turns with the loop, and then on two processes.  All metrics must be equal to the
last bit.
"""

from __future__ import annotations

import resource
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

import thorvaldc
from bench.figure import ROOT, Figure
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.tools.study import Study
from thorvaldc.tools.study.designs import designs_of
from thorvaldc.tools.study.evaluation import DesignEvaluator
from thorvaldc.tools.study.study_document import Design, StudyPlan

Result = TypeVar("Result")
EXAMPLES = ROOT / "examples"
SECONDS = 10.0
DESIGNS = 64
PROCESSES = 2
DEMANDED_MEMORY = 1500.0


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        study = example_study(Path(name), DESIGNS)
        designs = designs_of(study.plan)
        evaluator = DesignEvaluator(study.plan, None, stack)
        whole, plain, parallel = _Times(), _Times(), _Times()
        _drive(study.plan, designs[0])  # loads the library and MuJoCo
        for design in designs:
            result = whole.measure(lambda: evaluator.evaluate(design))  # noqa: B023
            metrics = plain.measure(lambda: _drive(study.plan, design))  # noqa: B023
            if result["metrics"] != {"traverse": metrics}:
                raise SystemExit("the study and the loop have other metrics")
        one = study.run(Path(name) / "one")
        two = parallel.measure(lambda: study.run(Path(name) / "two", jobs=PROCESSES))
        if not one.equals(two):
            raise SystemExit("the study has other results on several processes")
    simulated = SECONDS * len(designs)
    yield Figure(
        "a study on two processes",
        plain.wall / parallel.wall,
        "",
        None,
        "higher",
        "robot-seconds per second, relative to a loop over compile and simulation in one process:"
        f" {simulated / parallel.wall:.0f}, loop {simulated / plain.wall:.0f},"
        f" study on one process {simulated / whole.wall:.0f};"
        f" {len(designs)} designs of {SECONDS:g} s, with the start of the processes",
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
    return Study(path / "study.yaml")


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    if old not in text:
        raise SystemExit(f"{path.name} has no {old!r}")
    path.write_text(text.replace(old, new), encoding="utf-8")


def _drive(plan: StudyPlan, design: Design) -> dict[str, float]:
    ((_, scenario_file),) = plan.scenarios
    scenario = thorvaldc.compile(scenario_file, set=plan.changes(design)).scenario
    if scenario is None:
        raise SystemExit("a design does not compile")
    files = thorvaldc.emit(scenario.fleet, ["mjcf"])
    (metrics,) = ScenarioSimulation(scenario, files).play(Report()).metrics.values()
    return dict(metrics)
