"""``sim --replay``: a record through the outputs of a run, without a run."""

from __future__ import annotations

import heapq
import json as json_format
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.cli.faults import Faults, finite, message
from thorvaldc.cli.picturing import RunPictures
from thorvaldc.cli.recording import Robots, open_recorder, recorded, writing

if TYPE_CHECKING:
    from thorvaldc.compiler.compilation import Compilation
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Fleet, Robot
    from thorvaldc.runtime.base_interface import JointCommands
    from thorvaldc.simulation.control_loop import Sample
    from thorvaldc.simulation.physics.mujoco_base import MujocoScene
    from thorvaldc.simulation.records.recorded_run import RecordedRun


def replay(done: Compilation, source: str, pictures: RunPictures, record: str, json: bool) -> int:
    """Show how the compiled robots drove by the record ``source``; ``record`` writes it anew."""
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.simulation.physics.mujoco_base import MujocoScene
    from thorvaldc.simulation.run_result import result_table
    from thorvaldc.tools.replay import Replay, summary

    model, robots = _robots(done)
    report, faults = Report(), Faults("text", sys.stderr)
    runs = read_enough(source, robots, pictures, report)
    faults.add(report, _texts(source))
    if runs is None:
        return faults.finish()
    files, scene = None, Report()
    try:
        show = None
        if pictures.video:
            files = emit(model, ["mjcf"], scene)
            show = Replay(MujocoScene(files), robots, runs)
        samples = {name: run.samples for name, run in runs.items()}
        pictures.replay(samples, show)
    except DiagnosticError as fault:
        scene.put(fault.diagnostic)
        faults.add(done.located(scene), done.sources)
        return faults.finish()
    result = summary(robots, runs)
    if json:
        print(json_format.dumps(finite(result.as_json()), indent=1, ensure_ascii=False))
    else:
        print(result_table([result]))
    if record:
        with ExitStack() as stack:
            groups = next(iter(runs.values())).groups
            for recorder in open_recorder(record, robots, groups, 0.0, stack):
                for name, sample, commands in _in_order(runs):
                    recorder.record(name, sample, commands)
        message(recorded(record, robots))
    pictures.write(model, robots, files)
    return faults.finish()


def arranged(done: Compilation, source: str, time: float) -> Callable[[MujocoScene], None] | None:
    """What moves the compiled robots to where they were at ``time`` (s; beyond: at the end).

    ``None`` where the record is at fault, which is shown.
    """
    from thorvaldc.diagnostics import Report
    from thorvaldc.tools.replay import Replay

    _, robots = _robots(done)
    report, faults = Report(), Faults("text", sys.stderr)
    found = read_enough(source, robots, RunPictures(""), report)
    faults.add(report, _texts(source))
    faults.finish()
    if found is None:
        return None
    runs = found

    def arrange(scene: MujocoScene) -> None:
        replay = Replay(scene, robots, runs)
        replay.show(min(time, replay.end))

    return arrange


def _robots(done: Compilation) -> tuple[Robot | Fleet, Robots]:
    from thorvaldc.model import Fleet

    model = done.model
    if model is None:
        raise ValueError("only what compiles can be replayed")
    if isinstance(model, Fleet):
        return model, [(p.name, p.robot) for p in model.placements]
    return model, [(model.name, model)]


def _in_order(
    runs: Mapping[str, RecordedRun],
) -> Iterator[tuple[str, Sample, JointCommands | None]]:
    ticks = (
        [(name, *tick) for tick in zip(run.samples, run.commands, strict=True)]
        for name, run in runs.items()
    )
    return heapq.merge(*ticks, key=lambda tick: tick[1].time)


def read_enough(
    source: str, robots: Robots, pictures: RunPictures, report: Report
) -> dict[str, RecordedRun] | None:
    """The record, ``None`` where it is at fault or lacks what is asked for, which is said."""
    from thorvaldc.diagnostics import Span
    from thorvaldc.simulation.records.record_reader import read_record

    with writing(source):
        runs = read_record(Path(source), robots, report)
    if runs is None:
        return None
    wanted = {"--plot": ("odometry", "truth")} if pictures.plot else {}
    for name, run in runs.items():
        for option, groups in wanted.items():
            missing = [group for group in groups if group not in run.groups]
            if missing:
                report.add(
                    "record-incomplete",
                    f"`{source}` has no {' and no '.join(missing)} of {name}; {option} needs "
                    f"{' and '.join(groups)}",
                    Span(source),
                )
        if not {"odometry", "truth"} & set(run.groups):
            report.add(
                "record-incomplete",
                f"`{source}` has neither odometry nor truth of {name}",
                Span(source),
                hint="name one of them in `record: {what: ..}`, or leave `what` out",
            )
    return None if report.has_errors else runs


def _texts(source: str) -> dict[str, Path]:
    """The text files of the record by the names that diagnostics give them, for excerpts."""
    path = Path(source)
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    return {str(file): file for file in files if file.suffix == ".csv"}
