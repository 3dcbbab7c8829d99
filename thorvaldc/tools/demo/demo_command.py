"""The hidden command ``thorvaldc demo``: builds robots and drives each robot in simulation.

The demo prints a table with the results of all robots.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.tools.demo.demo import DemoOutcome


def demo(
    files: Annotated[list[str], typer.Argument(metavar="FILE")] = [],  # noqa: B006
    output: Annotated[str, typer.Option("--output", "-o", metavar="DIR")] = "build",
) -> int:
    from thorvaldc.cli.diagnostic_output import count, message, show_report, table_width
    from thorvaldc.compiler.output.writer import WriteError
    from thorvaldc.simulation.control_loop import result_table
    from thorvaldc.tools.demo.demo import DemoJob, run_demo

    started = time.monotonic()
    jobs = [DemoJob(file, output) for file in files]
    outcomes: list[DemoOutcome] = []
    try:
        for outcome in run_demo(jobs):
            outcomes.append(outcome)
            _show_progress(len(outcomes), len(jobs))
    except WriteError as error:
        raise OutsideError(str(error)) from None
    statuses = [show_report(outcome.report, outcome.sources) for outcome in outcomes]
    results = [outcome.result for outcome in outcomes if outcome.result is not None]
    if results:
        print(result_table(results, table_width()))
    robots = sum(len(result.robots) for result in results)
    seconds = time.monotonic() - started
    message(
        f"{count(len(jobs), 'file')} built to {output}/ and {count(robots, 'robot')} driven"
        f" in {seconds:.0f} s"
    )
    return DONE if jobs and all(status == DONE for status in statuses) else INPUT


def _show_progress(number: int, total: int) -> None:
    if sys.stderr.isatty():
        end = "\r" if number == total else ""
        print(f"\r{number} of {total}", end=end, file=sys.stderr, flush=True)
