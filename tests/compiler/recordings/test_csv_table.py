"""The limits of a CSV file: its numbers, its columns, its text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from thorvaldc.compiler.recordings import csv_table
from thorvaldc.compiler.recordings.csv_table import read_columns, read_header
from thorvaldc.diagnostics import Report


def read(path: Path) -> tuple[dict[str, Sequence[float]] | None, list[str]]:
    report = Report()
    header = read_header(path, path.name, report)
    table = None if header is None else read_columns(header, report)
    return table, [f"{d.span.line}: {d.message}" for d in report]


def test_a_file_with_too_many_numbers_ends_at_the_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_table, "_MAX_NUMBERS", 300_000)
    path = tmp_path / "log.csv"
    path.write_text("time,x\n" + "".join(f"{i},1\n" for i in range(150_000)))
    table, messages = read(path)
    assert table is not None
    assert len(table["time"]) == 150_000
    assert messages == []
    with path.open("a") as file:
        file.write("150000,1\n")
    table, messages = read(path)
    assert table is None
    assert messages == ["150002: `log.csv` has more than 0.3 million numbers"]


def test_a_first_line_without_end_has_too_many_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"," * 20_000_000)
    table, (message,) = read(path)
    assert table is None
    assert message.endswith("its first line has more than 10000 columns")


def test_text_is_checked_to_its_last_byte(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "time,µ\r\n0,1\r\n1,2\r\n".encode("utf-8-sig")
    path.write_bytes(rows)
    table, messages = read(path)
    assert table is not None
    assert messages == []
    assert list(table) == ["time", "µ"]
    assert list(table["µ"]) == [1.0, 2.0]
    # The last character is cut in its middle, behind the chunks that the reader checks.
    path.write_bytes(rows + b"\n" * (1 << 20) + "µ".encode()[:1])
    table, messages = read(path)
    assert table is None
    assert messages == ["1: `log.csv` is not UTF-8 text"]
