"""What a command prints: diagnostics and results as coloured text, as plain text or in a
machine-readable format, messages, and a progress bar."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import typer

from thorvaldc.cli.exits import DONE, INPUT, OUTSIDE
from thorvaldc.diagnostics import DiagnosticError, Report

if TYPE_CHECKING:  # the runtime package has no simulation
    from thorvaldc.simulation.control_loop import ControlLoop

FORMATS = ("text", "json", "github", "sarif")


def check_format(name: str, known: Sequence[str] = FORMATS) -> None:
    """Raises ``typer.BadParameter`` if the output format is unknown."""
    if name not in known:
        raise typer.BadParameter(f"{name!r} is none of {', '.join(known)}", param_hint="'--format'")


class DiagnosticOutput:
    """Collects the diagnostic reports of a command and prints them in the requested format.

    In the output format ``text``, diagnostics are printed on ``stream`` immediately, and result
    lines are printed on stdout. In the output formats ``json``, ``github`` and ``sarif``, all
    diagnostics are printed on stdout as one document at the end.
    """

    def __init__(self, format: str, stream: TextIO) -> None:
        self.format = format
        self.stream = stream
        self._all = Report()
        self._sources: dict[str, Path] = {}
        self._file_count = 0

    def add(self, report: Report, sources: Mapping[str, Path]) -> None:
        self._file_count += 1
        self._all.extend(report)
        self._sources.update(sources)
        if self.format == "text" and len(report) > 0:
            # A valid file has no diagnostics, and needs no renderers.
            from thorvaldc.diagnostics.renderers import render_text

            text = render_text(
                report, sources, color=has_color(self.stream), width=width_of(self.stream)
            )
            # The text of the function ``render_text`` ends with a blank line before the number of
            # errors. The method ``finish`` does not count failures outside of thorvaldc, such as a
            # full disk.
            outside = all(diagnostic.code.outside for diagnostic in report)
            print(text.rstrip("\n") if outside else text, file=self.stream)

    def result(self, line: str) -> None:
        """Prints a result line on stdout if the output format is ``text``."""
        if self.format == "text":
            print(line)

    def finish(self, strict: bool = False, **results: list[dict[str, Any]]) -> int:
        """Prints the number of errors or the machine-readable document, and returns the exit status
        of the command.

        ``results``: lists that the document in JSON contains too.
        """
        errors, warnings = len(self._all.errors), len(self._all.warnings)
        outside = [diagnostic for diagnostic in self._all.errors if diagnostic.code.outside]
        if self.format == "text" and len(outside) < len(self._all):
            counts = [count(errors, "error")] * (errors > 0)
            counts += [count(warnings, "warning")] * (warnings > 0)
            if counts:
                files = count(self._file_count, "file")
                hides = self._all.hides_checks
                more = "; more checks follow when they are corrected" if hides else ""
                print(f"{' and '.join(counts)} in {files}{more}", file=self.stream)
        elif self.format != "text":
            from thorvaldc.diagnostics.renderers import render

            text = render(self._all, self.format, self._sources, **results)
            if text:
                print(text)
        if errors and len(outside) == errors:
            return OUTSIDE
        return INPUT if errors or (strict and warnings) else DONE


def show_report(report: Report, sources: Mapping[str, Path]) -> int:
    """Prints the diagnostics of a report on stderr and returns the exit status of the command."""
    output = DiagnosticOutput("text", sys.stderr)
    output.add(report, sources)
    return output.finish()


def show_errors(report: Report, sources: Mapping[str, Path], file: str) -> int:
    """Prints a report as ``show_report`` does, but warnings without errors in one line.

    ``file``: the file, of which ``check`` and ``build`` print the warnings in full.
    """
    if report.has_errors or not report.warnings:
        return show_report(report, sources)
    message(f"{file}: {count(len(report.warnings), 'warning')}; `thorvaldc check` shows them")
    return DONE


def report_of(error: DiagnosticError) -> Report:
    """Returns a report with the diagnostic of a ``DiagnosticError``."""
    report = Report()
    report.put(error.diagnostic)
    return report


def has_color(stream: TextIO) -> bool:
    """Returns whether the text on an output stream may be coloured.

    By default, output on a terminal is coloured. The environment variables ``NO_COLOR`` and
    ``TERM=dumb`` turn colours off (no-color.org), and ``FORCE_COLOR`` turns colours on for any
    output.
    """
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    return bool(os.environ.get("FORCE_COLOR")) or stream.isatty()


def width_of(stream: TextIO) -> int:
    """Returns the width of the terminal in columns, or 100 if the stream is not a terminal."""
    return shutil.get_terminal_size((100, 24)).columns if stream.isatty() else 100


def table_width() -> int | None:
    """Returns the width of a table on stdout in columns, or ``None`` if stdout is no terminal."""
    return width_of(sys.stdout) if sys.stdout.isatty() else None


def message(text: str) -> None:
    """Prints a message for the user on stderr, because stdout is for results.

    On a terminal, long lines are broken between words.
    """
    if sys.stderr.isatty():
        width = max(width_of(sys.stderr), 30)
        text = "\n".join(_broken(line, width) for line in text.split("\n"))
    print(text, file=sys.stderr)


def _broken(line: str, width: int) -> str:
    if len(line) <= width:
        return line
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.fill(
        line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def print_json(value: Any, *, one_line: bool = False) -> None:
    """Prints the result of a command as JSON on stdout."""
    from thorvaldc.diagnostics.files import finite

    indent = None if one_line else 1
    print(json.dumps(finite(value), indent=indent, ensure_ascii=False), flush=one_line)


def print_table(rows: Iterable[tuple[str, str]]) -> None:
    """Prints a table with two columns: names and texts.

    Long texts in the table are wrapped to the width of the terminal.
    """
    from thorvaldc.diagnostics.text_layout import text_list

    rows = list(rows)
    longest = max((len(name) for name, _ in rows), default=0)
    for line in text_list(rows, max(width_of(sys.stdout), longest + 32)):
        print(line)


def count(number: int, noun: str) -> str:
    """Returns a number with a noun in singular or plural, such as ``1 error`` or ``2 errors``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


# -- progress --------------------------------------------------------------------

BAR_WIDTH = 30  # characters


class Progress:
    """A progress bar on stderr, which is shown only on a terminal.

    - ``total``: value at which the progress bar is full.
    - ``label``: text before the progress bar.
    """

    def __init__(self, total: float, unit: str = "s", label: str = "") -> None:
        self.total = total
        self.unit = unit
        self.label = f"{label} " if label else ""
        self.active = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._shown_percent = -1

    def show(self, value: float) -> None:
        """Shows the progress bar for ``value`` of the total."""
        percent = int(100 * min(value / self.total, 1.0)) if self.active else self._shown_percent
        if percent != self._shown_percent:
            self._shown_percent = percent
            print(f"\r{self.line(value)}", end="", file=sys.stderr, flush=True)

    def show_activity(self, activity: str, number: int, total: int) -> None:
        """Shows how much of an activity is done, such as the requests of a scan."""
        self.label, self.total = f"{activity} ", float(max(total, 1))
        self.show(float(number))

    def line(self, value: float) -> str:
        """Returns the progress bar for ``value`` of the total as text.

        The text is cut at the width of the terminal, because a wrapped line cannot be erased.
        """
        percent = int(100 * min(value / self.total, 1.0))
        bar = f"[{'#' * (percent * BAR_WIDTH // 100):<{BAR_WIDTH}}]"
        number = f"{value:.1f}" if self.unit == "s" else f"{value:.0f}"
        line = f"{self.label}{bar} {percent:3d} %  {number} of {self.total:g} {self.unit}"
        return line[: width_of(sys.stderr) - 1]

    def watch(self, loop: ControlLoop) -> None:
        """Shows the simulated time of a run in the progress bar."""
        self.show(loop.driver.state.time)

    def clear(self) -> None:
        """Erases the progress bar from the terminal."""
        if self._shown_percent >= 0:
            self._shown_percent = -1
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
