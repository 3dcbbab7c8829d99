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
    rows = _read_rows(lines, names, display, report)
    if rows is None:
        return None
    return Table(display, header, {name: [row[i] for row in rows] for i, name in enumerate(names)})


def _header_error(names: Sequence[str]) -> str | None:
    repeated = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if repeated is not None:
        return f"two columns `{repeated}`"
    if TIME not in names:
        return "no column `time`"
    return "no column except `time`" if len(names) < 2 else None


def _read_rows(
    lines: Sequence[str], names: Sequence[str], display: str, report: Report
) -> list[list[float]] | None:
    rows: list[list[float]] = []
    invalid_lines, last_time, time_index = 0, -math.inf, names.index(TIME)
    for line_number, raw_line in enumerate(lines[1:], start=2):
        line = raw_line.rstrip("\r")
        if not line.strip():
            continue
        cells = line.split(",")
        line_span = Span(display, line_number, 1, line_number, len(line) + 1)
        if len(cells) != len(names) and line_number == len(lines):
            message = f"`{display}` ends in an incomplete line, after {max(last_time, 0.0):.10g} s"
            report.add("record-truncated", message, line_span)
            break
        error = _row_error(cells, names, last_time, time_index)
        if error is None:
            rows.append([parse_number(cell) for cell in cells])
            last_time = rows[-1][time_index]
            continue
        index, message = error
        span = line_span if index is None else cell_span(display, line_number, line, index)
        report.add("record-value", message, span)
        invalid_lines += 1
        if invalid_lines >= _MAX_INVALID_LINES:
            break
    return None if invalid_lines else rows


def _row_error(
    cells: Sequence[str], names: Sequence[str], last_time: float, time_index: int
) -> tuple[int | None, str] | None:
    """Returns the index of the invalid cell (``None``: the whole line) and a message."""
    if len(cells) != len(names):
        return None, f"the line has {len(cells)} values; there are {len(names)} columns"
    for i, cell in enumerate(cells):
        if not math.isfinite(parse_number(cell)) and (cell.strip() or i == time_index):
            return i, f"`{cell.strip()}` in column {names[i]} is not a finite number"
    time = parse_number(cells[time_index])
    if not time > last_time:
        return time_index, f"the time goes from {last_time:.10g} s to {time:.10g} s"
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
