"""Reads CSV tables of numbers over time: the first line names the columns, one is ``time``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.diagnostics import Report, Span

TIME = "time"
_MAX_INVALID_LINES = 10
"""Number of invalid lines after which reading ends."""


@dataclass(frozen=True, slots=True)
class RowRules:
    """Diagnostic codes for invalid lines, and the rules that differ between kinds of tables.

    With ``complete`` an empty cell is an error, and so is an incomplete last line.
    """

    value_code: str
    time_code: str
    time_hint: str | None = None
    complete: bool = False


_RECORD_ROWS = RowRules("record-value", "record-value")


@dataclass(frozen=True, slots=True)
class Table:
    """The columns of a CSV file by name, and its first line."""

    display: str
    header: str
    columns: dict[str, list[float]]

    def __len__(self) -> int:
        return len(self.columns[TIME])

    def span_of(self, column: str) -> Span:
        """Returns the span of the column's name in the first line."""
        return cell_span(self.display, 1, self.header, list(self.columns).index(column))


def read_table(path: Path, display: str, report: Report) -> Table | None:
    """Reads a table; ``None`` on an error.  An empty cell is nan, except for the time.

    Reports errors with line and column.  An incomplete last line is ignored with a warning.
    """
    text = read_utf8(path, display, report)
    if text is None:
        return None
    lines = text.split("\n")
    header = lines[0].rstrip("\r")
    names = [name.strip() for name in header.split(",")]
    error = _header_error(names)
    if error is not None:
        message = f"`{display}` is not a table of a run: its first line has {error}"
        report.add("record-unreadable", message, Span(display, 1, 1, 1, 1))
        return None
    columns = read_columns(lines, names, display, report, _RECORD_ROWS)
    return None if columns is None else Table(display, header, columns)


def _header_error(names: Sequence[str]) -> str | None:
    repeated = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if repeated is not None:
        return f"two columns `{repeated}`"
    if TIME not in names:
        return "no column `time`"
    return "no column except `time`" if len(names) < 2 else None


def read_columns(
    lines: Sequence[str], names: Sequence[str], display: str, report: Report, rules: RowRules
) -> dict[str, list[float]] | None:
    """Returns the columns ``names`` of the lines after the first; ``None`` on an error.

    Reports invalid lines with line and column; stops after ``_MAX_INVALID_LINES`` of them.
    """
    rows: list[list[float]] = []
    invalid_lines, last_time, time_index = 0, -math.inf, names.index(TIME)
    for line_number, raw_line in enumerate(lines[1:], start=2):
        line = raw_line.rstrip("\r")
        if not line.strip():
            continue
        cells = line.split(",")
        line_span = Span(display, line_number, 1, line_number, len(line) + 1)
        is_cut = len(cells) != len(names) and line_number == len(lines)
        if is_cut and not rules.complete:
            message = f"`{display}` ends in an incomplete line, after {max(last_time, 0.0):.10g} s"
            report.add("record-truncated", message, line_span)
            break
        error = _value_error(cells, names, time_index, rules)
        time = parse_number(cells[time_index]) if error is None else math.nan
        if time > last_time:
            rows.append([parse_number(cell) for cell in cells])
            last_time = time
            continue
        if error is None:
            message = f"the time goes from {last_time:.10g} s to {time:.10g} s"
            span = cell_span(display, line_number, line, time_index)
            report.add(rules.time_code, message, span, hint=rules.time_hint)
        else:
            index, message = error
            span = line_span if index is None else cell_span(display, line_number, line, index)
            report.add(rules.value_code, message, span)
        invalid_lines += 1
        if invalid_lines >= _MAX_INVALID_LINES:
            break
    if invalid_lines:
        return None
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def _value_error(
    cells: Sequence[str], names: Sequence[str], time_index: int, rules: RowRules
) -> tuple[int | None, str] | None:
    """Returns the index of the invalid cell (``None``: the whole line) and a message."""
    if len(cells) != len(names):
        return None, f"the line has {len(cells)} values; there are {len(names)} columns"
    for i, cell in enumerate(cells):
        must_be_number = rules.complete or bool(cell.strip()) or i == time_index
        if must_be_number and not math.isfinite(parse_number(cell)):
            return i, f"`{cell.strip()}` in column {names[i]} is not a finite number"
    return None


def read_utf8(path: Path, display: str, report: Report) -> str | None:
    """Returns the text of a file; ``None`` on an error, which goes to ``report``."""
    data = read_bytes(path, display, report)
    if data is None:
        return None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        report.add("file-unreadable", f"`{display}` is not UTF-8 text", Span(display))
        return None


def parse_number(cell: str) -> float:
    """Returns the number in a cell, or nan if the cell does not contain a number."""
    try:
        # `float` also accepts 1_000.
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def cell_span(display: str, line_number: int, line: str, index: int) -> Span:
    """Returns the span of the cell with this index in a line."""
    cells = line.split(",")
    start = sum(len(cell) + 1 for cell in cells[:index]) + 1
    end = start + len(cells[index]) if index < len(cells) else start
    return Span(display, line_number, start, line_number, end)
