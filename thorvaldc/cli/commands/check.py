"""The commands ``thorvaldc check``, which reports every error in robot and fleet files, and
``explain``, which shows the page of a diagnostic code."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.completion import diagnostic_codes
from thorvaldc.cli.exits import DONE

if TYPE_CHECKING:
    from thorvaldc.cli.checked_file import CheckedFile
    from thorvaldc.diagnostics import Accepted

STANDARD_INPUT = "-"


def check(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE", help="A robot.yaml or fleet.yaml; - reads the standard input."
        ),
    ],
    format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="text|json|github|sarif|badge",
            help="Output format of the diagnostics; badge: the JSON of a shields.io endpoint.",
        ),
    ] = "text",
    strict: options.Strict = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Show accepted warnings with their reasons.")
    ] = False,
) -> int:
    from thorvaldc.cli.checked_file import check_file, check_files
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format, has_color
    from thorvaldc.compiler.bus.node_ids import without_lock_files

    if format != "badge":
        check_format(format)
    folders = options.library_folders(library)
    output = DiagnosticOutput(format, sys.stdout)
    missing: dict[str, None] = {}
    text: Path | None = None
    with ExitStack() as inputs:
        results: Iterator[CheckedFile]
        if STANDARD_INPUT in files:  # which only this process has
            text = inputs.enter_context(_standard_input())
            results = (check_file(file, folders, trust) for file in without_lock_files(files))
        else:
            results = check_files(list(without_lock_files(files)), folders, trust)
        for checked in results:
            if checked.file == STANDARD_INPUT and text is not None:
                checked.sources[STANDARD_INPUT] = text
            output.add(checked.report, checked.sources)
            missing.update(dict.fromkeys(checked.missing_limits))
            accepted = checked.report.accepted
            if accepted and verbose and format == "text":
                from thorvaldc.diagnostics.renderers import render_accepted

                print(render_accepted(checked.report, color=has_color(sys.stdout)))
            if checked.summary:
                more = f"; {_accepted(accepted)} accepted" if accepted else ""
                output.result(f"{checked.file}: {checked.summary}{more}")
    if format == "text" and missing:
        limits = "; ".join(missing)
        print(f"note: limits of the readers of xacro and meshes: {limits}", file=sys.stderr)
    return output.finish(strict)


def _accepted(accepted: list[Accepted]) -> str:
    """Returns the numbers of accepted warnings and notes, such as ``1 warning, 2 notes``."""
    from thorvaldc.cli.diagnostic_output import count
    from thorvaldc.diagnostics import Severity

    numbers = Counter(entry.diagnostic.severity for entry in accepted)
    kinds = (Severity.WARNING, Severity.NOTE)
    return ", ".join(count(numbers[kind], kind.value) for kind in kinds if numbers[kind])


@contextmanager
def _standard_input() -> Iterator[Path]:
    """Makes the standard input the content of the file ``-`` of the working folder.

    Paths in the document start there.  Returns a file with the same text, for excerpts.
    """
    import tempfile

    from thorvaldc.compiler.source.input_file import unsaved_texts
    from thorvaldc.compiler.source.reader import MAX_BYTES

    data = sys.stdin.buffer.read(MAX_BYTES + 1)  # a longer document is an error
    with tempfile.NamedTemporaryFile(prefix="thorvaldc-") as copy:
        copy.write(data)
        copy.flush()
        with unsaved_texts({os.path.realpath(STANDARD_INPUT): data}):
            yield Path(copy.name)


def explain(
    code: Annotated[
        str,
        typer.Argument(
            metavar="CODE",
            autocompletion=diagnostic_codes,
            help="TV501 or can-id-duplicate; without it, all codes are listed.",
        ),
    ] = "",
) -> int:
    from thorvaldc.diagnostics.codes import all_codes_text
    from thorvaldc.diagnostics.report import UnknownCode
    from thorvaldc.diagnostics.report import explain as page_of

    if not code:
        print(all_codes_text(), end="")
        return DONE
    try:
        print(page_of(code), end="")
    except UnknownCode as error:
        hint = f"; {error.hint}" if error.hint else ""
        raise typer.BadParameter(f"{error}{hint}", param_hint="CODE") from None
    return DONE
