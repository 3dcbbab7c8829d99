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
    from thorvaldc.diagnostics import Accepted
    from thorvaldc.model import Fleet, Robot

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
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput, check_format, has_color
    from thorvaldc.compiler.bus.node_ids import without_lock_files
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.compiler.sandbox import missing_limits

    if format != "badge":
        check_format(format)
    folders = options.library_folders(library)
    output = DiagnosticOutput(format, sys.stdout)
    with ExitStack() as inputs:
        text = inputs.enter_context(_standard_input()) if STANDARD_INPUT in files else None
        for file in without_lock_files(files):
            compilation = compile_file(file, library=folders, trust=trust)
            if file == STANDARD_INPUT and text is not None:
                compilation.sources[STANDARD_INPUT] = text
            output.add(compilation.report, compilation.sources)
            accepted = compilation.report.accepted
            if accepted and verbose and format == "text":
                from thorvaldc.diagnostics.renderers import render_accepted

                print(render_accepted(compilation.report, color=has_color(sys.stdout)))
            if compilation.model is not None:
                more = f"; {_accepted(accepted)} accepted" if accepted else ""
                summary = _summary(compilation.model)
                output.result(f"{file}: {compilation.model.name}, {summary}{more}")
    if format == "text" and missing_limits:
        missing = "; ".join(missing_limits)
        print(f"note: limits of the readers of xacro and meshes: {missing}", file=sys.stderr)
    return output.finish(strict)


def _accepted(accepted: list[Accepted]) -> str:
    """Returns the numbers of accepted warnings and notes, such as ``1 warning, 2 notes``."""
    from thorvaldc.cli.diagnostic_output import count
    from thorvaldc.diagnostics import Severity

    numbers = Counter(entry.diagnostic.severity for entry in accepted)
    kinds = (Severity.WARNING, Severity.NOTE)
    return ", ".join(count(numbers[kind], kind.value) for kind in kinds if numbers[kind])


def _summary(model: Robot | Fleet) -> str:
    """Returns a summary of a robot, such as ``4 wheels (4 driven, 4 steered), 213.4 kg``."""
    from thorvaldc.cli.diagnostic_output import count
    from thorvaldc.model import Fleet

    if isinstance(model, Fleet):
        return count(len(model.placements), "robot")
    driven = sum(1 for wheel in model.wheels if wheel.driven)
    steered = sum(1 for wheel in model.wheels if wheel.steered)
    wheels = count(len(model.wheels), "wheel")
    return f"{wheels} ({driven} driven, {steered} steered), {model.inertial.mass:.1f} kg"


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
