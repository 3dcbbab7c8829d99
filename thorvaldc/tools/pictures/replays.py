"""Recorded runs for the commands ``replay``, ``render`` and ``sim``."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from thorvaldc.cli.diagnostic_output import message, print_json, report_of, show_report, table_width
from thorvaldc.cli.run_pictures import RunPictures
from thorvaldc.cli.run_records import Robots, open_recorders, record_summary, write_errors
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Fleet, Robot
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.control_loop import Sample, result_table
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.records.recorder import RecordedRun
from thorvaldc.tools.pictures.replay import Replay, summary
from thorvaldc.tools.pictures.replay_record import read_replay_record, text_sources


def replay_run(
    compilation: Compilation,
    model: Robot | Fleet,
    source: str,
    pictures: RunPictures,
    record: str,
    json: bool,
) -> int:
    """Prints the result of a recorded run, draws its plot and video, and returns the exit status.

    - ``source``: path of the record.
    - ``record``: path for a copy of the record in another format, or empty for no copy.
    """
    robots = _robots_of(model)
    runs, status = _read_record(source, robots, for_plot=bool(pictures.plot))
    if runs is None:
        return status
    files = None
    try:
        scenes = None
        if pictures.video:
            report = Report()
            files = emit(model, ["mjcf"], report)
            scenes = Replay(MujocoScene(files), robots, runs).scenes
        pictures.take_record({name: run.samples for name, run in runs.items()}, scenes)
    except DiagnosticError as error:
        return show_report(compilation.located(report_of(error)), compilation.sources)
    result = summary(robots, runs)
    if json:
        print_json(result.as_json())
    else:
        print(result_table([result], table_width()))
    if record:
        _convert_record(record, robots, runs)
    pictures.write(model, robots, files)
    return status


def arrangement(
    model: Robot | Fleet, source: str, time: float
) -> Callable[[MujocoScene], None] | None:
    """Returns a function that moves the robots of a MuJoCo scene to their recorded poses at
    ``time`` (s).

    For a time after the end of the record, the robots move to their last recorded poses. If the
    record of the run has errors, the function prints the errors and returns ``None``.
    """
    robots = _robots_of(model)
    runs, _ = _read_record(source, robots, for_plot=False)
    if runs is None:
        return None
    recorded_runs = runs

    def arrange(scene: MujocoScene) -> None:
        replay = Replay(scene, robots, recorded_runs)
        replay.show(min(time, replay.end))

    return arrange


def _robots_of(model: Robot | Fleet) -> Robots:
    if isinstance(model, Fleet):
        return [(placement.name, placement.robot) for placement in model.placements]
    return [(model.name, model)]


def _read_record(
    source: str, robots: Robots, *, for_plot: bool
) -> tuple[dict[str, RecordedRun] | None, int]:
    """Returns the recorded runs by robot name, and the exit status for the diagnostics of the
    record."""
    report = Report()
    with write_errors(source):
        runs = read_replay_record(Path(source), robots, report, for_plot=for_plot)
    return runs, show_report(report, text_sources(Path(source)))


def _convert_record(record: str, robots: Robots, runs: Mapping[str, RecordedRun]) -> None:
    groups: Sequence[str] = next(iter(runs.values())).groups
    with ExitStack() as stack:
        for recorder in open_recorders(record, robots, groups, 0.0, stack):
            for name, sample, commands in _by_time(runs):
                recorder.record(name, sample, commands)
    message(record_summary(record, robots))


def _by_time(
    runs: Mapping[str, RecordedRun],
) -> Iterator[tuple[str, Sample, JointCommands | None]]:
    """Yields the recorded samples of all robots, sorted by time."""
    ticks = (
        [(name, *tick) for tick in zip(run.samples, run.commands, strict=True)]
        for name, run in runs.items()
    )
    return heapq.merge(*ticks, key=lambda tick: tick[1].time)
