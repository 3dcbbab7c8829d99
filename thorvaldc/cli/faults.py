"""Showing reports: on a terminal with colours, elsewhere plain, or for machines."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import typer

from thorvaldc.cli.exits import DONE, INPUT, OUTSIDE

if TYPE_CHECKING:
    from thorvaldc.diagnostics import Report

FORMATS = ("text", "json", "github", "sarif")


def check_format(name: str) -> None:
    """Raises ``typer.BadParameter`` for a format there is not."""
    if name not in FORMATS:
        raise typer.BadParameter(
            f"{name!r} is none of {', '.join(FORMATS)}", param_hint="'--format'"
        )


class Faults:
    """The reports and results of a command's files, shown as the user wants them.

    As text, faults go to ``stream`` at once and results to stdout; for
    machines all faults go to stdout as one document at the end.
    """

    def __init__(self, format: str, stream: TextIO) -> None:
        from thorvaldc.diagnostics import Report

        self.format = format
        self.stream = stream
        self._all = Report()
        self._sources: dict[str, Path] = {}
        self._files = 0

    def add(self, report: Report, sources: Mapping[str, Path]) -> None:
        self._files += 1
        self._all.extend(report)
        self._sources.update(sources)
        if self.format == "text" and len(report) > 0:
            from thorvaldc.diagnostics.render import render_text

            text = render_text(
                report, sources, color=has_color(self.stream), width=width_of(self.stream)
            )
            # The blank line at the end is for the count, which there is none of then.
            outside = all(fault.code.outside for fault in report)
            print(text.rstrip("\n") if outside else text, file=self.stream)

    def result(self, line: str) -> None:
        """A line of the command's result; left out of the output for machines."""
        if self.format == "text":
            print(line)

    def finish(self, strict: bool = False, builds: list[dict[str, Any]] | None = None) -> int:
        """Show what is left, and return the exit status."""
        errors, warnings = len(self._all.errors), len(self._all.warnings)
        outside = [fault for fault in self._all.errors if fault.code.outside]
        if self.format == "text" and len(outside) < len(self._all):
            found = [count(errors, "error")] * (errors > 0)
            found += [count(warnings, "warning")] * (warnings > 0)
            if found:
                print(f"{' and '.join(found)} in {count(self._files, 'file')}", file=self.stream)
        elif self.format != "text":
            from thorvaldc.diagnostics.render import render

            text = render(self._all, self.format, self._sources, builds=builds)
            if text:
                print(text)
        if errors and len(outside) == errors:
            return OUTSIDE
        return INPUT if errors or (strict and warnings) else DONE


def has_color(stream: TextIO) -> bool:
    """A terminal that shows colours, unless the user wants none (no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    return bool(os.environ.get("FORCE_COLOR")) or stream.isatty()


def width_of(stream: TextIO) -> int:
    """Columns of the terminal; 100 where there is none."""
    import shutil

    return shutil.get_terminal_size((100, 24)).columns if stream.isatty() else 100


def message(text: str) -> None:
    """A line for the user, which is not part of the result."""
    print(text, file=sys.stderr)


def count(number: int, noun: str) -> str:
    """``1 error``, ``2 errors``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def finite(value: Any) -> Any:
    """JSON has no infinities: a number that a run away simulation left becomes null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value
