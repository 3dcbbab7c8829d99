"""``thorvaldc sim``: drives a robot or fleet in simulation.

``sim`` also accepts the options that belong to the commands ``scenario``, ``batch`` and
``replay``, which were parts of ``sim``; its help does not show them.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import typer

from thorvaldc.cli.compiling import compile_and_show
from thorvaldc.cli.diagnostic_output import message, print_json, show_report
from thorvaldc.cli.exits import INPUT
from thorvaldc.cli.options import (
    BatchOutput,
    Draws,
    DrawSeed,
    Duration,
    Jobs,
    JointLog,
    Json,
    JUnit,
    Library,
    Parameters,
    Plot,
    Record,
    Settings,
    Variations,
    Video,
    parse_duration,
    refuse_options,
)
from thorvaldc.cli.progress import Progress
from thorvaldc.cli.replays import replay_run
from thorvaldc.cli.run_pictures import RunPictures
from thorvaldc.cli.run_records import call_all, open_joint_logs, open_recorders, record_summary
from thorvaldc.cli.scenario_runs import plan_runs, run_batch, run_scenario, single_run
from thorvaldc.compiler.compilation import Compilation
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.scenario.variations import Change
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.twist_text import parse_twist
from thorvaldc.simulation.control_loop import TickCallback
from thorvaldc.simulation.records.recorder import record_ticks
from thorvaldc.simulation.run_result import result_table
from thorvaldc.simulation.simulation_run import Simulation

TWIST_DURATION = 5.0
"""s of a twist without ``--duration``."""


class _Drive(NamedTuple):
    """What to drive: twist (empty: the manoeuvre), duration in s (0: the default) and options."""

    twist: str
    duration: float
    parameters: str
    ideal: bool
    open_loop: bool


def sim(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A robot.yaml, fleet.yaml or scenario.")
    ],
    twist: Annotated[
        str,
        typer.Option(
            "--twist",
            metavar="VX,VY,WZ",
            help="Twist to drive, in m/s, m/s and rad/s; by default a manoeuvre that shows what the"
            " robot can do.",
        ),
    ] = "",
    duration: Duration = "",
    parameters: Parameters = "",
    ideal: Annotated[
        bool, typer.Option("--ideal", help="Simulate ideal joints instead of physics.")
    ] = False,
    open_loop: Annotated[
        bool,
        typer.Option("--open-loop", help="Drive without speed control, for a log to calibrate."),
    ] = False,
    record: Record = "",
    log: JointLog = "",
    plot: Plot = "",
    video: Video = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
    scenario: Annotated[str, typer.Option("--scenario", metavar="FILE")] = "",
    junit: JUnit = "",
    settings: Settings = [],  # noqa: B006
    variations: Variations = False,
    draws: Draws = "",
    seed: DrawSeed = "",
    jobs: Jobs = "",
    output: BatchOutput = "",
    replay: Annotated[str, typer.Option("--replay", metavar="RECORD")] = "",
) -> int:
    seconds = parse_duration(duration, "--duration") if duration else 0.0
    drive_options = {"--duration": duration, "--twist": twist, "--ideal": ideal}
    drive_options["--open-loop"] = open_loop
    run_options = {"--parameters": parameters, "--junit": junit, "--log": log}
    name, robot = scenario or file, file if scenario else None
    changes: Sequence[Change] = ()
    if settings or variations:
        planned = plan_runs(name, settings, draws, seed, own=variations)
        if planned is None:
            return INPUT
        only_changes = single_run(planned)
        if only_changes is None:
            outputs = {"--record": record, "--plot": plot, "--video": video, "--replay": replay}
            reason = f"this is for one run, and there are {planned.size}"
            refuse_options({**drive_options, **run_options, **outputs}, reason)
            return run_batch(name, planned, robot, library, jobs=jobs, output=output, json=json)
        changes = only_changes
    else:
        batch_options = {"--draws": draws, "--seed": seed, "--jobs": jobs, "--output": output}
        refuse_options(batch_options, "this is for --set and --variations")
    pictures = RunPictures(plot, video, ideal=ideal)
    if replay:
        refuse_options({**drive_options, **run_options}, "a replay takes the run from its record")
    compilation = compile_and_show(name, library, robot, changes)
    if compilation.model is None:
        return INPUT
    if replay:
        return replay_run(compilation, compilation.model, replay, pictures, record, json)
    if compilation.scenario is not None:
        refuse_options(drive_options, "the scenario defines this")
        return run_scenario(
            compilation,
            compilation.scenario,
            pictures,
            parameters=parameters,
            record=record,
            junit=junit,
            log=log,
            json=json,
        )
    refuse_options({"--scenario": scenario, "--junit": junit}, f"{name} is no scenario")
    drive = _Drive(twist, seconds, parameters, ideal, open_loop)
    return _run(compilation, compilation.model, drive, pictures, record, log, json)


def _run(
    compilation: Compilation,
    model: Robot | Fleet,
    drive: _Drive,
    pictures: RunPictures,
    record: str,
    log: str,
    json: bool,
) -> int:
    gc.enable()
    report = Report()
    try:
        files = None if drive.ideal else emit(model, ["mjcf"], report)
        simulation = Simulation(model, files, drive.parameters or None, open_loop=drive.open_loop)
        twist = parse_twist(drive.twist) if drive.twist else None
        default = TWIST_DURATION if twist is not None else simulation.demonstration()[1]
        duration = drive.duration or default
        robots = simulation.robots
        with contextlib.ExitStack() as stack:
            progress = Progress(duration)
            watches: list[TickCallback] = [progress.watch, pictures.watch]
            recorders = open_recorders(record, robots, GROUPS, 0.0, stack)
            if recorders:
                watches.append(record_ticks(recorders))
            if log:
                watches.append(open_joint_logs(log, robots, stack))
            stack.callback(progress.clear)
            if twist is not None:
                result = simulation.run(duration, twist, report, call_all(watches))
            else:
                result = simulation.demonstrate(report, duration, call_all(watches))
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return show_report(compilation.located(report), compilation.sources)
    if json:
        print_json(result.as_json())
    else:
        print(result_table([result]))
    status = show_report(compilation.located(report), compilation.sources)
    if record:
        message(record_summary(record, robots))
    pictures.write(model, robots, files)
    return status
