"""Runs of scenarios for the commands ``scenario``, ``batch`` and ``sim``."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import typer

from thorvaldc.cli.diagnostic_output import message, print_json, show_report, table_width
from thorvaldc.cli.options import parse_count
from thorvaldc.cli.progress import Progress
from thorvaldc.cli.run_pictures import RunPictures, check_output
from thorvaldc.cli.run_records import call_all, open_joint_logs, open_recorders, record_summary
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.scenario.variations import Change, Variations, plan_variations
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.diagnostics.atomic_file import write_file
from thorvaldc.model.scenario import Scenario
from thorvaldc.simulation.control_loop import TickCallback
from thorvaldc.simulation.scenario_run import ScenarioSimulation, junit_report, scenario_text


def run_scenario(
    compilation: Compilation,
    scenario: Scenario,
    pictures: RunPictures,
    *,
    parameters: str,
    record: str,
    junit: str,
    log: str,
    json: bool,
) -> int:
    """Runs a scenario, prints its result and returns the exit status.

    - ``record``: path of the record, or empty for no record.
    - ``junit``: path of the JUnit report, or empty for no report.
    - ``log``: path of the joint log, or empty for no joint log.
    """
    if junit:
        check_output(junit, ("xml",), "--junit")
    gc.enable()
    report = Report()
    progress = Progress(scenario.duration)
    robots = [(placement.name, placement.robot) for placement in scenario.fleet.placements]
    with ExitStack() as stack:
        recorders = open_recorders(record, robots, scenario.record, scenario.every, stack)
        watches: list[TickCallback] = [progress.watch, pictures.watch]
        if log:
            watches.append(open_joint_logs(log, robots, stack))
        stack.callback(progress.clear)
        try:
            files = emit(scenario.fleet, ["mjcf"], report)
            simulation = ScenarioSimulation(scenario, files, parameters or None)
            result = simulation.play(report, recorders, call_all(watches))
        except DiagnosticError as error:
            report.put(error.diagnostic)
            return show_report(compilation.located(report), compilation.sources)
    if junit:
        errors = [d.message for d in report.errors if d.code.name != "expectation-failed"]
        write_file(Path(junit), junit_report(result, errors))
    if json:
        print_json(result.as_json())
    else:
        print(scenario_text(result, table_width()))
    status = show_report(compilation.located(report), compilation.sources)
    if record:
        message(record_summary(record, robots))
    pictures.write(scenario.fleet, robots, files)
    return status


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


def single_run(variations: Variations) -> tuple[Change, ...] | None:
    """Returns the changed values of the scenario for a single run, and ``None`` for several
    runs."""
    return next(variations.runs()) if variations.size == 1 else None
