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
class RowRules:
    """Rules for checking the data lines of a CSV file.

    - ``value_code``: name of the diagnostic for an invalid cell or a wrong number of cells.
    - ``time_code``: name of the diagnostic for a time that does not increase.
    - ``time_hint``: hint of the diagnostic for a time that does not increase.
    - ``complete``: whether empty cells and an incomplete last line are errors.
    """

    value_code: str
    time_code: str
    time_hint: str | None = None
    complete: bool = False


_RECORD_ROWS = RowRules("record-value", "record-value")


@dataclass(frozen=True, slots=True)
class Table:
    """The content of a CSV file: first line and columns of numbers.

    - ``display``: name of the file in messages.
    - ``header``: first line of the file.
    - ``columns``: numbers of each column, by the name of the column.
    """

    display: str
    header: str
    columns: dict[str, Sequence[float]]

    def __len__(self) -> int:
        return len(self.columns[TIME])

    def span_of(self, column: str) -> Span:
        """Returns the source span of a column name in the first line of the CSV file."""
        return cell_span(self.display, 1, self.header, list(self.columns).index(column))


def read_table(path: Path, display: str, report: Report) -> Table | None:
    """Reads a CSV file with the samples of a run.  Returns ``None`` if the file has an error.

    The value of an empty cell is nan.  An empty cell in the column ``time`` of the CSV file is an
    error.  If the last line of the CSV file is incomplete, the reader ignores the line and reports
    a warning.
    """
    data = read_utf8(path, display, report)
    if data is None:
        return None
    header = first_line(data)
    names = column_names(header)
    error = _header_error(names)
    if error is not None:
        message = f"`{display}` is not a table of a run: its first line has {error}"
        report.add("record-unreadable", message, Span(display, 1, 1, 1, 1))
        return None
    columns = read_columns(data, names, display, report, _RECORD_ROWS)
    return None if columns is None else Table(display, header, columns)


def first_line(data: bytes) -> str:
    """Returns the first line of a CSV file, with the column names.

    A first line of more than 1 MB is cut.
    """
    end = data.find(b"\n", 0, _MAX_HEADER_BYTES)
    line = data[: end if end >= 0 else _MAX_HEADER_BYTES]
    return line.decode("utf-8", "replace").rstrip("\r")


def column_names(header: str) -> list[str]:
    """Returns the names in the first line of a CSV file.

    After the largest number of columns, the rest of the line is one name.
    """
    return [name.strip() for name in header.split(",", _MAX_COLUMNS)]


def _header_error(names: Sequence[str]) -> str | None:
    if len(names) > _MAX_COLUMNS:
        return f"more than {_MAX_COLUMNS} columns"
    repeated = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if repeated is not None:
        return f"two columns `{repeated}`"
    if TIME not in names:
        return "no column `time`"
    return "no column except `time`" if len(names) < 2 else None


def read_columns(
    data: bytes, names: Sequence[str], display: str, report: Report, rules: RowRules
) -> dict[str, Sequence[float]] | None:
    """Returns the numbers in each column of a CSV file, or ``None`` if a line is invalid.

    - ``data``: bytes of the file in UTF-8, including the first line with the column names.
    - ``names``: names of the columns, in the order of the file.
    - ``rules``: diagnostic codes for invalid lines.

    Each invalid line of the CSV file is reported with its line and column number.  Stops after
    ``_MAX_INVALID_LINES`` invalid lines of the CSV file, and with more than 20 million numbers.
    """
    columns = [array("d") for _ in names]
    most_rows = _MAX_NUMBERS // len(names)
    invalid_lines, last_time, time_index = 0, -math.inf, names.index(TIME)
    for line_number, line, is_last in _data_lines(data):
        cells = line.split(",", len(names))  # at most one cell more than columns
        line_span = Span(display, line_number, 1, line_number, len(line) + 1)
        is_cut = len(cells) != len(names) and is_last
        if is_cut and not rules.complete:
            message = f"`{display}` ends in an incomplete line, after {max(last_time, 0.0):.10g} s"
            report.add("record-truncated", message, line_span)
            break
        error = _value_error(cells, names, time_index, rules)
        time = parse_number(cells[time_index]) if error is None else math.nan
        if time > last_time and len(columns[0]) >= most_rows:
            message = f"`{display}` has more than {_MAX_NUMBERS / 1e6:g} million numbers"
            report.add("file-unreadable", message, line_span)
            return None
        if time > last_time:
            for column, cell in zip(columns, cells, strict=True):
                column.append(parse_number(cell))
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
    return dict(zip(names, columns, strict=True))


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
    cells: Sequence[str], names: Sequence[str], time_index: int, rules: RowRules
) -> tuple[int | None, str] | None:
    """Returns the error in a CSV line as (cell index, message), or ``None`` if the line is valid.

    The cell index is ``None`` if the CSV line has the wrong number of cells.
    """
    if len(cells) != len(names):
        more = "more than " if len(cells) > len(names) else ""
        count = min(len(cells), len(names))
        return None, f"the line has {more}{count} values; there are {len(names)} columns"
    for i, cell in enumerate(cells):
        must_be_number = rules.complete or bool(cell.strip()) or i == time_index
        if must_be_number and not math.isfinite(parse_number(cell)):
            return i, f"`{cell.strip()}` in column {names[i]} is not a finite number"
    return None


def read_utf8(path: Path, display: str, report: Report) -> bytes | None:
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


def cell_span(display: str, line_number: int, line: str, index: int) -> Span:
    """Returns the source span of the CSV cell with the number ``index`` (from 0) in a line."""
    cells = line.split(",")
    start = sum(len(cell) + 1 for cell in cells[:index]) + 1
    end = start + len(cells[index]) if index < len(cells) else start
    return Span(display, line_number, start, line_number, end)
