"""Tables of numbers over time, as CSV: the first line names the columns, one is ``time``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.diagnostics import Report, Span

TIME = "time"
_MOST_FAULTS = 10
"""Faults of values that are told before reading ends."""


@dataclass(frozen=True, slots=True)
class Table:
    """The columns of a file by their names, and its first line."""

    display: str
    head: str
    columns: dict[str, list[float]]

    def __len__(self) -> int:
        return len(self.columns[TIME])

    def span_of(self, column: str) -> Span:
        """Where the column is named."""
        return cell_span(self.display, 1, self.head, list(self.columns).index(column))


def read_table(path: Path, display: str, report: Report) -> Table | None:
    """The table in a file; an empty cell is nan, but of the time.

    All that is wrong with it goes to ``report``, with line and column.  If only its last line
    breaks off, that is a warning, and the line is left out.
    """
    text = read_utf8(path, display, report)
    if text is None:
        return None
    lines = text.split("\n")
    head = lines[0].rstrip("\r")
    names = [name.strip() for name in head.split(",")]
    if TIME not in names or len(set(names)) < len(names) or len(names) < 2:
        twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
        said = "no column `time`" if twice is None else f"two columns `{twice}`"
        report.add(
            "record-unreadable",
            f"`{display}` is no table of a run: it has {said} in its first line"
            if TIME not in names or twice
            else f"`{display}` is no table of a run: it has no column but `time`",
            Span(display, 1, 1, 1, 1),
        )
        return None
    rows = _rows(lines, names, display, report)
    if rows is None:
        return None
    return Table(display, head, {name: [row[i] for row in rows] for i, name in enumerate(names)})


def _rows(
    lines: Sequence[str], names: Sequence[str], display: str, report: Report
) -> list[list[float]] | None:
    rows: list[list[float]] = []
    faults, before, clock = 0, -math.inf, names.index(TIME)
    for count, raw in enumerate(lines[1:], start=2):
        line = raw.rstrip("\r")
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(names) and count == len(lines):
            report.add(
                "record-truncated",
                f"`{display}` breaks off in its last line, after {max(before, 0.0):.10g} s",
                Span(display, count, 1, count, len(line) + 1),
            )
            break
        fault = _fault(cells, names, before, clock)
        if fault is None:
            rows.append([parse_number(cell) for cell in cells])
            before = rows[-1][clock]
            continue
        index, message = fault
        span = Span(display, count, 1, count, len(line) + 1)
        report.add(
            "record-value", message, span if index < 0 else cell_span(display, count, line, index)
        )
        faults += 1
        if faults >= _MOST_FAULTS:
            break
    return None if faults else rows


def _fault(
    cells: Sequence[str], names: Sequence[str], before: float, clock: int
) -> tuple[int, str] | None:
    """What is wrong with a line: the index of the cell (-1: all of it) and what to say."""
    if len(cells) != len(names):
        return -1, f"the line has {len(cells)} values; there are {len(names)} columns"
    for i, cell in enumerate(cells):
        if not math.isfinite(parse_number(cell)) and (cell.strip() or i == clock):
            return i, f"`{cell.strip()}` in column {names[i]} is not a finite number"
    time = parse_number(cells[clock])
    if not time > before:
        return clock, f"the time goes from {before:.10g} s to {time:.10g} s"
    return None


def read_utf8(path: Path, display: str, report: Report) -> str | None:
    """The text of a file; what keeps it from being read goes to ``report``."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
    except IsADirectoryError:
        report.add(
            "file-is-a-directory", f"`{display}` is a folder; a file is wanted", Span(display)
        )
    except UnicodeDecodeError:
        report.add("file-unreadable", f"`{display}` is not UTF-8 text", Span(display))
    except (OSError, ValueError) as fault:
        reason = (fault.strerror if isinstance(fault, OSError) else None) or str(fault)
        report.add("file-unreadable", f"`{display}` cannot be read: {reason}", Span(display))
    return None


def parse_number(cell: str) -> float:
    """The number in a cell, nan if there is none."""
    try:
        # Python would take 1_000 as well.
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def cell_span(display: str, line: int, text: str, index: int) -> Span:
    """The span of a cell of a line."""
    cells = text.split(",")
    start = sum(len(cell) + 1 for cell in cells[:index]) + 1
    end = start + len(cells[index]) if index < len(cells) else start
    return Span(display, line, start, line, end)
