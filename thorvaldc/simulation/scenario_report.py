"""Formats the result of a scenario as text and as JUnit XML."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.simulation.run_result import result_table
from thorvaldc.simulation.scenario_expectations import ScenarioResult


def scenario_text(result: ScenarioResult, width: int | None = None) -> str:
    """Returns a text with the result table of the robots and one line for each expectation.

    ``width``: number of columns of the terminal, or ``None`` for one line per robot.
    """
    run = result.run
    lines = [result_table([run], width)]
    for check in result.checks:
        verdict = "ok    " if check.passed else "FAILED"
        lines.append(
            f"{verdict}  {check.robot} {check.metric}: {check.value_text} ({check.bounds})"
        )
    passed = sum(1 for check in result.checks if check.passed)
    end = "" if result.completed else f", ended after {run.simulated:.2f} s"
    lines.append(
        f"{result.scenario}: {passed} of {len(result.checks)} expectations met{end}, "
        f"result {result.hash[:16]}"
    )
    return "\n".join(lines)


def junit_report(result: ScenarioResult, errors: Sequence[str]) -> bytes:
    """Returns a JUnit XML report of a scenario run.

    The report has one test case for the completion of the run and one test case for each
    expectation.  ``errors`` are the error messages of a run that did not complete.
    """
    name = result.scenario
    test_count = len(result.checks) + 1
    failed = sum(1 for check in result.checks if not check.passed) + (not result.completed)
    suite = Element(
        "testsuite",
        name=name,
        tests=test_count,
        failures=failed,
        errors=0,
        skipped=0,
        time=round(result.run.simulated, 6),
    )
    suite.add("properties").add("property", name="hash", value=result.hash)
    case = suite.add("testcase", classname=name, name="runs to its end")
    if not result.completed:
        case.add("failure", message="; ".join(errors) or "the run did not complete")
    for check in result.checks:
        case = suite.add("testcase", classname=f"{name}.{check.robot}", name=check.metric)
        if not check.passed:
            case.add("failure", message=f"{check.value_text}; {check.bounds} is expected")
    suites = Element("testsuites", name="thorvaldc", tests=test_count, failures=failed)
    suites.append(suite)
    return to_bytes(suites)
