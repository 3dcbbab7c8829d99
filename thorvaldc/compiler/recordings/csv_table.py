"""Reads CSV files with a time column and columns of numbers.

The first line of a CSV file contains the names of the columns.  One column of the CSV file is named
``time``.
"""

from __future__ import annotations

import codecs
import math
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.files import MAX_LOG_BYTES

TIME = "time"
_MAX_COLUMNS = 10_000
_MAX_NUMBERS = 20_000_000
"""Limit of the numbers in a file, which bounds the memory: 160 MB."""
_MAX_HEADER_BYTES = 1_000_000
_CHUNK = 1 << 20
_MAX_INVALID_LINES = 10
"""The reader stops after this number of invalid lines in a file."""


@dataclass(frozen=True, slots=True)
class Header:
    """The first line of a CSV file, with the names of its columns.

    - ``display``: name of the file in messages.
    - ``line``: first line of the file.
    - ``names``: names of the columns in the order of the file; ``time`` and others.
    - ``data``: bytes of the file in UTF-8.
    """

    display: str
    line: str
    names: list[str]
    data: bytes

    def span_of(self, column: str) -> Span:
        """Returns the source span of a column name in the first line of the CSV file."""
        return _cell_span(self.display, 1, self.line, self.names.index(column))

    @property
    def span(self) -> Span:
        """The source span of diagnostics about the whole line."""
        return Span(self.display, 1, 1, 1, 1)


def read_header(path: Path, display: str, report: Report) -> Header | None:
    """Reads a CSV file and the names of its columns.

    If the file cannot be read or is not a table of a run, adds an error to ``report`` and returns
    ``None``.  A first line of more than 1 MB is cut.
    """
    data = _read_utf8(path, display, report)
    if data is None:
        return None
    end = data.find(b"\n", 0, _MAX_HEADER_BYTES)
    line = data[: end if end >= 0 else _MAX_HEADER_BYTES].decode("utf-8", "replace").rstrip("\r")
    # After the largest number of columns, the rest of the line is one name.
    names = [name.strip() for name in line.split(",", _MAX_COLUMNS)]
    span, error = Span(display, 1, 1, 1, 1), None
    repeated = next((i for i, name in enumerate(names) if name in names[:i]), None)
    if len(names) > _MAX_COLUMNS:
        error = f"more than {_MAX_COLUMNS} columns"
    elif repeated is not None:
        error = f"two columns `{names[repeated]}`"
        span = _cell_span(display, 1, line, repeated)
    elif TIME not in names:
        error = "no column `time`"
    elif len(names) < 2:
        error = "no column except `time`"
    if error is not None:
        message = f"`{display}` is not a table of a run: its first line has {error}"
        report.add("record-unreadable", message, span)
        return None
    return Header(display, line, names, data)


def read_columns(
    header: Header, report: Report, *, complete: bool = False
) -> dict[str, Sequence[float]] | None:
    """Returns the numbers in each column of a CSV file, or ``None`` if a line is invalid.

    The value of an empty cell is nan.  An empty cell in the column ``time`` is an error.  If the
    last line is incomplete, the reader ignores it and reports a warning.  ``complete``: every empty
    cell and an incomplete last line are errors.

    Each invalid line of the CSV file is reported with its line and column number.  Stops after
    ``_MAX_INVALID_LINES`` invalid lines of the CSV file, and with more than 20 million numbers.
    """
    display, names = header.display, header.names
    columns = [array("d") for _ in names]
    most_rows = _MAX_NUMBERS // len(names)
    invalid_lines, last_time, time_index = 0, -math.inf, names.index(TIME)
    for line_number, line, is_last in _data_lines(header.data):
        cells = line.split(",", len(names))  # at most one cell more than columns
        line_span = Span(display, line_number, 1, line_number, len(line) + 1)
        if len(cells) != len(names) and is_last and not complete:
            message = f"`{display}` ends in an incomplete line, after {max(last_time, 0.0):.10g} s"
            report.add("record-truncated", message, line_span)
            break
        error = _value_error(cells, names, time_index, complete)
        hint = None
        if error is None:
            time = parse_number(cells[time_index])
            if time <= last_time:
                error = time_index, f"the time goes from {last_time:.10g} s to {time:.10g} s"
                hint = "times must increase; write each run to a file of its own"
        if error is not None:
            index, message = error
            span = line_span if index is None else _cell_span(display, line_number, line, index)
            report.add("record-value", message, span, hint=hint)
            invalid_lines += 1
            if invalid_lines >= _MAX_INVALID_LINES:
                break
            continue
        if len(columns[0]) >= most_rows:
            message = f"`{display}` has more than {_MAX_NUMBERS / 1e6:g} million numbers"
            report.add("file-unreadable", message, line_span)
            return None
        for column, cell in zip(columns, cells, strict=True):
            column.append(parse_number(cell))
        last_time = time
    return None if invalid_lines else dict(zip(names, columns, strict=True))


def _data_lines(data: bytes) -> Iterator[tuple[int, str, bool]]:
    """Yields the number and text of each line with data, and whether the line is the last one.

    A list of all lines would need several times the memory of a long file.
    """
    number, start = 1, data.find(b"\n") + 1
    while start > 0:
        end = data.find(b"\n", start)
        line = data[start : end if end >= 0 else len(data)].decode("utf-8").rstrip("\r")
        number += 1
        if line.strip():
            yield number, line, end < 0
        start = end + 1


def _value_error(
    cells: Sequence[str], names: Sequence[str], time_index: int, complete: bool
) -> tuple[int | None, str] | None:
    """Returns the error in a CSV line as (cell index, message), or ``None`` if the line is valid.

    The cell index is ``None`` if the CSV line has the wrong number of cells.
    """
    if len(cells) != len(names):
        more = "more than " if len(cells) > len(names) else ""
        count = min(len(cells), len(names))
        return None, f"the line has {more}{count} values; there are {len(names)} columns"
    for i, cell in enumerate(cells):
        must_be_number = complete or bool(cell.strip()) or i == time_index
        if must_be_number and not math.isfinite(parse_number(cell)):
            return i, f"`{cell.strip()}` in column {names[i]} is not a finite number"
    return None


def _read_utf8(path: Path, display: str, report: Report) -> bytes | None:
    """Returns the bytes of a file in UTF-8, without a byte order mark.

    The text of a long log would need the memory of the log a second time.  If the file cannot be
    read, adds an error to ``report`` and returns ``None``.
    """
    data = read_bytes(path, display, report, limit=MAX_LOG_BYTES)
    if data is None:
        return None
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for start in range(0, len(data), _CHUNK):
            decoder.decode(data[start : start + _CHUNK])
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        report.add("file-unreadable", f"`{display}` is not UTF-8 text", Span(display))
        return None
    return data.removeprefix(codecs.BOM_UTF8)


def parse_number(cell: str) -> float:
    """Returns the number in a CSV cell, or nan if the cell does not contain a number."""
    try:
        # Python's `float` accepts the text `1_000`, which is not a number in a CSV file.
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _cell_span(display: str, line_number: int, line: str, index: int) -> Span:
    """Returns the source span of the CSV cell with the number ``index`` (from 0) in a line."""
    cells = line.split(",")
    start = sum(len(cell) + 1 for cell in cells[:index]) + 1
    end = start + len(cells[index]) if index < len(cells) else start
    return Span(display, line_number, start, line_number, end)
