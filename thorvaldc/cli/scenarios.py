"""``sim`` of a scenario: records, reports, a progress bar, and what decides the exit status."""

from __future__ import annotations

import gc
import json as json_format
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc.cli.faults import Faults, finite, message
from thorvaldc.cli.picturing import RunPictures, check_output
from thorvaldc.cli.progress import Progress
from thorvaldc.cli.recording import each, open_logs, open_recorder, recorded

if TYPE_CHECKING:
    from thorvaldc.compiler.compilation import Compilation
    from thorvaldc.model.scenario import Scenario
    from thorvaldc.simulation.control_loop import TickCallback
    from thorvaldc.simulation.scenario_run import ScenarioResult


def run_scenario(
    done: Compilation,
    scenario: Scenario,
    pictures: RunPictures,
    parameters: str | None,
    record: str,
    junit: str,
    log: str,
    json: bool,
) -> int:
    """Run it, report it.  ``record``, ``junit`` and ``log`` are files or folders, or empty."""
    if junit:
        check_output(junit, ("xml",), "--junit")
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.simulation.scenario_run import ScenarioSimulation

    gc.enable()
    report = Report()
    faults = Faults("text", sys.stderr)
    progress = Progress(scenario.duration)
    robots = [(p.name, p.robot) for p in scenario.fleet.placements]
    with ExitStack() as stack:
        recorders = open_recorder(record, robots, scenario.record, scenario.every, stack)
        watches: list[TickCallback] = [progress.watch, pictures.watch]
        if log:
            watches.append(open_logs(log, robots, stack))
        stack.callback(progress.clear)
        try:
            files = emit(scenario.fleet, ["mjcf"], report)
            simulation = ScenarioSimulation(scenario, files, parameters)
            result = simulation.play(report, recorders, each(watches))
        except DiagnosticError as fault:
            report.put(fault.diagnostic)
            faults.add(done.located(report), done.sources)
            return faults.finish()
    if junit:
        said = [d.message for d in report.errors if d.code.name != "expectation-failed"]
        Path(junit).write_bytes(junit_report(result, said))
    if json:
        print(json_format.dumps(finite(result.as_json()), indent=1, ensure_ascii=False))
    else:
        print(_text(result))
    faults.add(done.located(report), done.sources)
    if record:
        message(recorded(record, robots))
    pictures.write(scenario.fleet, robots, files)
    return faults.finish()


def _text(result: ScenarioResult) -> str:
    from thorvaldc.simulation.run_result import result_table

    run = result.run
    lines = [result_table([run])]
    for check in result.checks:
        mark = "ok    " if check.passed else "FAILED"
        lines.append(f"{mark}  {check.robot} {check.metric}: {check.value_text} ({check.bounds})")
    passed = sum(check.passed for check in result.checks)
    end = "" if result.completed else f", ended after {run.simulated:.2f} s"
    lines.append(
        f"{result.scenario}: {passed} of {len(result.checks)} expectations met{end}, "
        f"result {result.hash[:16]}"
    )
    return "\n".join(lines)


def junit_report(result: ScenarioResult, faults: Sequence[str]) -> bytes:
    """The result as JUnit XML: a test for the run itself, and one for each expectation."""
    from thorvaldc.backends.xml_writer import Element, to_bytes

    name = result.scenario
    failed = sum(not check.passed for check in result.checks) + (not result.completed)
    suite = Element(
        "testsuite",
        name=name,
        tests=len(result.checks) + 1,
        failures=failed,
        errors=0,
        skipped=0,
        time=round(result.run.simulated, 6),
    )
    suite.add("properties").add("property", name="hash", value=result.hash)
    case = suite.add("testcase", classname=name, name="runs to its end")
    if not result.completed:
        case.add("failure", message="; ".join(faults) or "it did not run to its end")
    for check in result.checks:
        case = suite.add("testcase", classname=f"{name}.{check.robot}", name=check.metric)
        if not check.passed:
            case.add("failure", message=f"{check.value_text}; {check.bounds} is expected")
    top = Element("testsuites", name="thorvaldc", tests=len(result.checks) + 1, failures=failed)
    top.append(suite)
    return to_bytes(top)
