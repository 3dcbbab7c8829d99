"""The commands ``thorvaldc sim``, which drives a robot or fleet in simulation, and ``scenario``,
which runs a scenario and checks its expectations."""

from __future__ import annotations

import gc
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import (
    Progress,
    message,
    print_json,
    show_report,
    table_width,
)
from thorvaldc.cli.exits import DONE, INPUT, OutsideError, write_errors
from thorvaldc.cli.robot_file import compile_and_show
from thorvaldc.diagnostics import DiagnosticError, Report

if TYPE_CHECKING:
    from thorvaldc.cli.run_outputs import RunOutputs
    from thorvaldc.compiler.result import Compilation
    from thorvaldc.model import Fleet, Robot
    from thorvaldc.model.scenario import Scenario
    from thorvaldc.runtime.se2 import Twist
    from thorvaldc.simulation.scenario_run import ScenarioResult
    from thorvaldc.simulation.scenario_sweep import ResultFile, Run, Sweep
    from thorvaldc.simulation.simulation_result import SimulationResult


TWIST_DURATION = 5.0
"""Duration in s of a run with a twist and without the option ``--duration``."""


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
    duration: options.Duration = "",
    parameters: options.Parameters = "",
    ideal: Annotated[
        bool, typer.Option("--ideal", help="Simulate ideal joints instead of physics.")
    ] = False,
    open_loop: Annotated[
        bool,
        typer.Option("--open-loop", help="Drive without speed control, for a log to calibrate."),
    ] = False,
    sensors: Annotated[
        bool,
        typer.Option("--sensors", help="Record the sensors of the modules as well, in a .mcap."),
    ] = False,
    record: options.Record = "",
    log: options.JointLog = "",
    plot: options.Plot = "",
    video: options.Video = "",
    json: options.Json = False,
    settings: options.Settings = [],  # noqa: B006
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.run_outputs import RunOutputs
    from thorvaldc.runtime.se2 import parse_twist

    seconds = options.parse_duration(duration, "--duration") if duration else 0.0
    commanded_twist = options.parsed(twist, parse_twist, "--twist") if twist else None
    outputs = RunOutputs(plot, video, record, log, ideal=ideal)
    if sensors and not record.lower().endswith(".mcap"):
        raise typer.BadParameter("needs a --record OUT.mcap", param_hint="'--sensors'")
    compilation = compile_and_show(file, library, None, options.new_values(settings), trust=trust)
    if compilation.model is None:
        return INPUT
    if compilation.scenario is not None:
        drive_options = {"--duration": duration, "--twist": twist, "--ideal": ideal}
        drive_options["--sensors"] = sensors
        options.refuse_options(drive_options, "the scenario defines this")
        open_loop = open_loop or compilation.scenario.open_loop
        changed = replace(compilation.scenario, open_loop=open_loop)
        return _run_scenario(compilation, changed, outputs, parameters, json)
    return _run_drive(
        compilation,
        compilation.model,
        outputs,
        parameters,
        json,
        twist=commanded_twist,
        duration=seconds,
        ideal=ideal,
        open_loop=open_loop,
        sensors=sensors,
    )


def scenario(
    file: options.ScenarioFile,
    robot: options.ScenarioRobot = "",
    settings: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUES",
            autocompletion=options.document_paths,
            help="Replace a value of the file: world.friction=0.3; several values, 0.3,0.6, make"
            " a run with each. May be repeated.",
            show_default=False,
        ),
    ] = [],  # noqa: B006
    jobs: options.Jobs = "",
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT.csv", help="Write the results of all runs."),
    ] = "",
    parameters: options.Parameters = "",
    junit: options.JUnit = "",
    record: options.Record = "",
    log: options.JointLog = "",
    plot: options.Plot = "",
    video: options.Video = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.run_outputs import RunOutputs

    process_count = options.parse_count(jobs, "--jobs", 1)
    choices = options.choices(settings)
    if output or any(len(values) > 1 for values in choices.values()):
        of_one_run = {"--parameters": parameters, "--junit": junit, "--record": record}
        of_one_run |= {"--log": log, "--plot": plot, "--video": video}
        options.refuse_options(of_one_run, "not with several values or --output")
        from thorvaldc.simulation.scenario_sweep import Sweep

        folders = options.library_folders(library)
        sweep = Sweep(file, choices, robot or None, folders, trust)
        return _sweep(sweep, process_count, output, json)
    outputs = RunOutputs(plot, video, record, log)
    values = {path: nodes[0] for path, nodes in choices.items()}
    compilation = compile_and_show(file, library, robot or None, values, trust=trust)
    if compilation.model is None:
        return INPUT
    if compilation.scenario is None:
        raise _no_scenario(file)
    return _run_scenario(compilation, compilation.scenario, outputs, parameters, json, junit)


def _no_scenario(file: Path | str) -> typer.BadParameter:
    reason = f"{file} is no scenario; `thorvaldc sim {file}` drives a robot or fleet"
    return typer.BadParameter(reason, param_hint="SCENARIO")


MAX_RUNS = 100_000
SHOWN_FAILURES = 10
"""Largest number of failed runs of a sweep whose diagnostics are printed."""


def _sweep(sweep: Sweep, process_count: int | None, output: str, json: bool) -> int:
    """Runs a sweep, prints its table and returns the exit status.

    ``process_count``: number of processes, or ``None`` for one on each processor.
    """
    from thorvaldc.simulation.scenario_sweep import ResultFile
    from thorvaldc.simulation.worker_processes import processors

    gc.enable()
    if output:
        options.check_output(output, ("csv",), "--output")
    if len(sweep) > MAX_RUNS:
        reason = f"these are {len(sweep)} runs; there must be at most {MAX_RUNS}"
        raise typer.BadParameter(reason, param_hint="'--set'")
    compilation = sweep.check()
    if compilation.model is None:
        return show_report(compilation.report, compilation.sources)
    if compilation.scenario is None:
        raise _no_scenario(sweep.scenario)
    with write_errors(output):
        file = ResultFile(Path(output)) if output else None
    runs = _runs_of(sweep, process_count or processors(), file, json)
    failed_runs = [run for run in runs if run.errors]
    for run in failed_runs[:SHOWN_FAILURES]:
        for text in run.errors:
            message(f"run {run.number}: {text}")
    hidden = len(failed_runs) - SHOWN_FAILURES
    if hidden > 0:
        message(f"and {hidden} more {'run' if hidden == 1 else 'runs'}")
    return DONE if all(run.passed for run in runs) else INPUT


def _runs_of(sweep: Sweep, process_count: int, file: ResultFile | None, json: bool) -> list[Run]:
    """Runs a sweep and returns the results in the order of the run numbers.

    If an exception occurs, also Ctrl-C, the results of the completed runs are still printed and
    written.
    """
    from thorvaldc.simulation.scenario_sweep import results_table, runs_as_json

    runs: list[Run] = []
    bar = Progress(len(sweep), "runs")
    with file or nullcontext():
        try:
            bar.show(0)
            for run in sweep.runs(process_count):
                runs.append(run)
                bar.show(len(runs))
                if file is not None:
                    file.append(run)
        except OSError:
            raise
        except RuntimeError as error:  # a process of the sweep was killed
            raise OutsideError(str(error)) from None
        finally:
            bar.clear()
            runs.sort(key=lambda run: run.number)
            if json:
                print(runs_as_json(runs))
            elif runs:
                print(results_table(runs, table_width(), len(sweep)))
            if len(runs) < len(sweep):
                message(f"{len(runs)} of {len(sweep)} runs are done")
    return runs


def _run_scenario(
    compilation: Compilation,
    scenario: Scenario,
    outputs: RunOutputs,
    parameters: str,
    json: bool,
    junit: str = "",
) -> int:
    """Runs a scenario, prints its result and returns the exit status."""
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics.files import write_file
    from thorvaldc.simulation import scenario_run

    if junit:
        options.check_output(junit, ("xml",), "--junit")
    outputs.check_installation()
    gc.enable()
    report = Report()
    robots = [(placement.name, placement.robot) for placement in scenario.fleet.placements]
    opened = outputs.open(robots, scenario.record, scenario.every, scenario.duration)
    with opened as (recorders, watch):
        try:
            files = emit(scenario.fleet, ["mjcf"], report)
            simulation = scenario_run.ScenarioSimulation(scenario, files, parameters or None)
            result = simulation.play(report, recorders, watch)
        except DiagnosticError as error:
            report.put(error.diagnostic)
            return show_report(compilation.located(report), compilation.sources)
    if junit:
        errors = [d.message for d in report.errors if d.code.name != "expectation-failed"]
        write_file(Path(junit), scenario_run.junit_report(result, errors))
    text = "" if json else scenario_run.scenario_text(result, table_width())
    status = _show(compilation, report, result, text)
    outputs.write(scenario.fleet, robots, files)
    return status


def _run_drive(
    compilation: Compilation,
    model: Robot | Fleet,
    outputs: RunOutputs,
    parameters: str,
    json: bool,
    *,
    twist: Twist | None,
    duration: float,
    ideal: bool,
    open_loop: bool,
    sensors: bool,
) -> int:
    """Drives a robot or fleet in simulation, prints the result and returns the exit status.

    - ``twist``: commanded twist, or ``None`` for the demonstration manoeuvre of the robot.
    - ``duration``: duration in s, or 0 for the default duration.
    """
    from thorvaldc.cli.run_outputs import call_all
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.model.scenario import GROUPS, SensorSettings
    from thorvaldc.model.sensor_numbers import not_simulated
    from thorvaldc.simulation.records.recorder import record_ticks
    from thorvaldc.simulation.simulation_result import result_table
    from thorvaldc.simulation.simulation_run import Simulation

    outputs.check_installation()
    gc.enable()
    report = Report()
    try:
        files = None if ideal else emit(model, ["mjcf"], report)
        simulation = Simulation(
            model,
            files,
            parameters or None,
            open_loop=open_loop,
            sensors=SensorSettings() if sensors else None,
        )
        if sensors and not simulation.sensors:
            message("no robot has a sensor that is simulated")
        left_out = not_simulated(simulation.robots.values()) if sensors else []
        if left_out:
            message(f"not simulated: {', '.join(left_out)}")
        if not duration:
            duration = TWIST_DURATION if twist is not None else simulation.demonstration()[1]
        robots = [*simulation.robots.items()]
        with outputs.open(robots, GROUPS, 0.0, duration) as (recorders, watch):
            simulation.episode.record_sensors(recorders)
            if recorders:
                watch = call_all([watch, record_ticks(recorders)])
            if twist is not None:
                result = simulation.run(duration, twist, report, watch)
            else:
                result = simulation.demonstrate(report, duration, watch)
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return show_report(compilation.located(report), compilation.sources)
    text = "" if json else result_table([result], table_width())
    status = _show(compilation, report, result, text)
    outputs.write(model, robots, files)
    return status


def _show(
    compilation: Compilation,
    report: Report,
    result: SimulationResult | ScenarioResult,
    text: str,
) -> int:
    """Prints a result as text, or as JSON if the text is empty, and returns the exit status."""
    if text:
        print(text)
    else:
        print_json(result.as_json())
    return show_report(compilation.located(report), compilation.sources)
