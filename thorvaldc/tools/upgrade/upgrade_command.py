"""The command ``thorvaldc upgrade``: rewrites older files to the present language."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import diagnostic_output, options
from thorvaldc.cli.diagnostic_output import count, message
from thorvaldc.cli.exits import DONE, INPUT, OUTSIDE
from thorvaldc.diagnostics import Report

if TYPE_CHECKING:
    from thorvaldc.tools.upgrade.file_upgrade import Upgrade


def upgrade(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE", help="A robot, module, fleet, scenario, study or calibration file."
        ),
    ],
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Write nothing; print the difference, with the exit status 1 if there is one.",
        ),
    ] = False,
    json: options.Json = False,
) -> int:
    from thorvaldc.diagnostics.report import grouped
    from thorvaldc.tools.upgrade.file_upgrade import upgrade_file

    output = diagnostic_output.DiagnosticOutput("json" if json else "text", sys.stderr)
    decisions, sources, status = Report(), {}, DONE
    upgrades = []
    for path in map(Path, dict.fromkeys(files)):
        result = upgrade_file(path)
        sources[str(path)] = path
        errors = Report()
        errors.extend(result.report.errors)
        output.add(errors, sources)
        decisions.extend(d for d in result.report if d not in result.report.errors)
        difference = result.difference() if dry_run else ""
        is_due = result.is_changed and not dry_run
        is_written = is_due and _write(result)
        if is_due and not is_written:
            status = OUTSIDE
        elif difference:
            status = max(status, INPUT)
        upgrades.append(
            {
                "file": str(path),
                "changes": result.changes,
                "difference": difference,
                "written": is_written,
            }
        )
        if json or is_due != is_written:
            continue
        sys.stdout.write(difference)
        if result.before is not None:
            line = f"{path}: {_summary(result, dry_run)}"
            print(line, file=sys.stderr if dry_run else sys.stdout)
    merged = Report()
    merged.extend(grouped(decisions))
    if json:
        output.add(merged, sources)
    else:
        diagnostic_output.show_report(merged, sources)
    return max(status, output.finish(upgrades=upgrades))


def _write(result: Upgrade) -> bool:
    """Replaces the file in one step, or leaves it as it was and prints the reason."""
    from thorvaldc.diagnostics.files import write_file

    assert result.after is not None
    try:
        write_file(result.path, result.after.data)
    except OSError as error:
        message(f"error: {result.path}: {error.strerror or error}; it is unchanged")
        return False
    return True


def _summary(result: Upgrade, dry_run: bool) -> str:
    decisions = len(list(result.report)) - len(result.report.errors)
    verb = "would be upgraded" if dry_run else "upgraded"
    changes = f"{verb}: {count(result.changes, 'change')}"
    text = changes if result.changes else "nothing to change"
    if decisions:
        text += f"; {count(decisions, 'decision')} for you"
    if result.report.errors:
        text += f"; {count(len(result.report.errors), 'error')}"
    return text
