"""Runs in simulation for the commands ``sim``, ``scenario`` and ``batch``."""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import typer

from thorvaldc.cli import run_outputs
from thorvaldc.cli.diagnostic_output import message, print_json, show_report, table_width
from thorvaldc.cli.options import check_output, parse_count
from thorvaldc.cli.progress import Progress
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.scenario.variations import Variations, plan_variations
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.diagnostics.files import write_file
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS, Scenario, SensorSettings
from thorvaldc.model.sensor_numbers import not_simulated
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation import scenario_run
from thorvaldc.simulation.control_loop import TickCallback
from thorvaldc.simulation.records.recorder import Recorder, record_ticks
from thorvaldc.simulation.simulation_result import SimulationResult, result_table
from thorvaldc.simulation.simulation_run import Simulation

TWIST_DURATION = 5.0
"""Duration in s of a run with a twist and without the option ``--duration``."""


class RunOptions(NamedTuple):
    """The options of a run, as their texts.  Empty: none.

    - ``parameters``: parameter set of the robot file.
    - ``record``, ``log``, ``junit``: paths of the record, the joint log and the JUnit report.
    - ``json``: whether the result is printed as JSON.
    """

    pictures: run_outputs.RunPictures
    parameters: str
    record: str
    log: str
    json: bool
    junit: str = ""

    def open(
        self,
        robots: run_outputs.Robots,
        groups: Sequence[str],
        every: float,
        duration: float,
        stack: ExitStack,
    ) -> tuple[Sequence[Recorder], list[TickCallback]]:
        """Opens the outputs of a run, and returns the recorders and what is called in each tick."""
        recorders = run_outputs.open_recorders(self.record, robots, groups, every, stack)
        progress = Progress(duration)
        watches: list[TickCallback] = [progress.watch, self.pictures.watch]
        if self.log:
            watches.append(run_outputs.open_joint_logs(self.log, robots, stack))
        stack.callback(progress.clear)
        return recorders, watches

    def show(
        self,
        compilation: Compilation,
        report: Report,
        result: SimulationResult | scenario_run.ScenarioResult,
        robots: run_outputs.Robots,
        files: Mapping[str, bytes] | None,
    ) -> int:
        """Prints a result, draws the pictures of the run and returns the exit status."""
        if self.json:
            print_json(result.as_json())
        elif isinstance(result, SimulationResult):
            print(result_table([result], table_width()))
        else:
            print(scenario_run.scenario_text(result, table_width()))
        status = show_report(compilation.located(report), compilation.sources)
        if self.record:
            message(run_outputs.record_summary(self.record, robots))
        if compilation.model is not None:
            self.pictures.write(compilation.model, robots, files)
        return status


def run_scenario(compilation: Compilation, scenario: Scenario, options: RunOptions) -> int:
    """Runs a scenario, prints its result and returns the exit status."""
    if options.junit:
        check_output(options.junit, ("xml",), "--junit")
    options.pictures.check_installation()
    gc.enable()
    report = Report()
    robots = [(placement.name, placement.robot) for placement in scenario.fleet.placements]
    with ExitStack() as stack:
        recorders, watches = options.open(
            robots, scenario.record, scenario.every, scenario.duration, stack
        )
        try:
            files = emit(scenario.fleet, ["mjcf"], report)
            simulation = scenario_run.ScenarioSimulation(
                scenario, files, options.parameters or None
            )
            result = simulation.play(report, recorders, run_outputs.call_all(watches))
        except DiagnosticError as error:
            report.put(error.diagnostic)
            return show_report(compilation.located(report), compilation.sources)
    if options.junit:
        errors = [d.message for d in report.errors if d.code.name != "expectation-failed"]
        write_file(Path(options.junit), scenario_run.junit_report(result, errors))
    return options.show(compilation, report, result, robots, files)


def run_drive(
    compilation: Compilation,
    model: Robot | Fleet,
    options: RunOptions,
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
    options.pictures.check_installation()
    gc.enable()
    report = Report()
    try:
        files = None if ideal else emit(model, ["mjcf"], report)
        simulation = Simulation(
            model,
            files,
            options.parameters or None,
            open_loop=open_loop,
            sensors=SensorSettings() if sensors else None,
        )
        if sensors and not simulation.sensors:
            message("no robot has a sensor that is simulated")
        left_out = not_simulated(robot for _, robot in simulation.robots) if sensors else []
        if left_out:
            message(f"not simulated: {', '.join(left_out)}")
        if not duration:
            duration = TWIST_DURATION if twist is not None else simulation.demonstration()[1]
        with ExitStack() as stack:
            recorders, watches = options.open(simulation.robots, GROUPS, 0.0, duration, stack)
            simulation.record_sensors(recorders)
            if recorders:
                watches.append(record_ticks(recorders))
            if twist is not None:
                result = simulation.run(duration, twist, report, run_outputs.call_all(watches))
            else:
                result = simulation.demonstrate(report, duration, run_outputs.call_all(watches))
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return show_report(compilation.located(report), compilation.sources)
    return options.show(compilation, report, result, simulation.robots, files)


def plan_runs(
    scenario: str, settings: Sequence[str], draws: str, seed: str, *, from_document: bool
) -> Variations | None:
    """Returns the variations of a scenario from the options ``--set``.

    If ``from_document`` is true, the result includes the variations in the scenario file. If the
    scenario file has errors, the function prints the errors and returns ``None``. Raises
    ``typer.BadParameter`` if an option ``--set`` is wrong or no value of the scenario varies.
    """
    for text in settings:
        path, equals, _ = text.partition("=")
        if not equals or not path.strip():
            raise typer.BadParameter(f"{text!r} is not PATH=VALUES", param_hint="'--set'")
    report = Report()
    variations = plan_variations(
        scenario,
        settings,
        parse_count(draws, "--draws", 1),
        parse_count(seed, "--seed", 0),
        from_document=from_document,
        report=report,
    )
    if variations is None:
        raise typer.BadParameter(f"{scenario} is no scenario", param_hint="'FILE'")
    if report.has_errors:
        show_report(report, {scenario: Path(scenario)})
        return None
    if not variations.varied and not (from_document and variations.draws > 1):
        raise typer.BadParameter(
            f"{scenario} has no `variations`; name values with --set", param_hint="'--variations'"
        )
    return variations
