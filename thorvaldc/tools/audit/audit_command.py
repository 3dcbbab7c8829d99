"""The command ``thorvaldc audit``: reports contradictions in the files of any robot."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from thorvaldc.cli import options

MAX_SHOWN = 8  # folders that are left out


def audit(
    names: Annotated[
        list[str],
        typer.Argument(metavar="DIR|FILE", help="Folders or files of a robot, of any origin."),
    ],
    format: options.Format = "text",
    json: options.Json = False,
    strict: options.Strict = False,
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format, count
    from thorvaldc.tools.audit.audit_run import audit as audit_files

    format = "json" if json else format
    check_format(format)
    output = DiagnosticOutput(format, sys.stdout)
    result = audit_files(names, trust=trust)
    output.add(result.report, result.sources)
    evidence = result.evidence
    read = [
        count(len(evidence.descriptions), "description"),
        count(len(evidence.sections), "section") + " of parameters",
        count(len(evidence.launches), "launch file"),
    ]
    left_out = result.left_out
    more = [f"and {len(left_out) - MAX_SHOWN} more"] if len(left_out) > MAX_SHOWN else []
    ignored = f"; left out: {', '.join([*left_out[:MAX_SHOWN], *more])}" if left_out else ""
    output.result(f"{', '.join(names)}: {', '.join(read)}{ignored}")
    return output.finish(strict)
