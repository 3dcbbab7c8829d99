"""Tables and lists fit their width, and no character of a cell is lost."""

from __future__ import annotations

import re

import pytest

from thorvaldc.diagnostics.text_layout import (
    markdown_table,
    markdown_text,
    text_list,
    text_table,
)

HEADINGS = ("robot", "mass", "wheels driven/steered", "commanded", "true", "odometry", "end error")
ROWS = [
    HEADINGS,
    ("slim", "150.0 kg", "4: 4/4", "0.129 m", "0.124 m", "0.124 m", "0.0 mm"),
    ("farm_north/thorvald_9wd9ws_asymmetric", "1367.2 kg", "9: 9/9", "-", "1.1 m", "2 m", "0.0 mm"),
]


def test_a_table_without_a_width_has_one_line_per_row() -> None:
    lines = text_table(ROWS, None, right=range(1, 7)).splitlines()
    assert len(lines) == len(ROWS)
    assert lines[2].startswith(ROWS[2][0])
    assert len({line.index("0.0 mm") for line in lines[1:]}) == 1


@pytest.mark.parametrize("width", range(20, 130, 3))
def test_a_table_fits_every_width_and_keeps_every_character(width: int) -> None:
    text = text_table(ROWS, width, right=range(1, 7))
    assert max(map(len, text.splitlines())) <= max(width, len(ROWS[2][0]) + 2)
    for row in ROWS[1:]:
        for cell in row:
            for part in re.split(r"(?<=[_/])|\s+", cell):
                assert part in text


def test_headings_take_several_lines_before_names_do() -> None:
    lines = text_table(ROWS, 100, right=range(1, 7)).splitlines()
    assert "driven/" in lines[1]
    assert any(ROWS[2][0] in line for line in lines)


def test_names_and_words_are_not_broken_in_80_columns() -> None:
    row = ("thorvald_4wd4ws_wide", *ROWS[1][1:], "40x")
    assert row[0] in text_table([(*HEADINGS, "real time"), row], 80, right=range(1, 8))
    assert "battery_enclosure_" in text_table(
        [("name", "text"), ("battery_enclosure_part", "x" * 20)], 40
    )


def test_a_terminal_that_is_too_narrow_gets_a_paragraph_per_row() -> None:
    lines = text_table(ROWS, 40).splitlines()
    assert lines[0].startswith("robot slim  mass 150.0 kg")


def test_a_table_without_headings_with_least_widths() -> None:
    assert text_table([("", ""), ("a", "b"), ("c", "d")], least=(3, 0)) == "a    b\nc    d"


def test_a_name_that_is_too_long_has_its_own_line() -> None:
    rows = [("mass", "5 kg or a little more"), ("a_long_name", "7 m"), ("empty", "")]
    lines = ["mass    5 kg or a", "        little more", "a_long_name", "        7 m", "empty"]
    assert list(text_list(rows, 20, most=6)) == lines


def test_markdown() -> None:
    rows = [("name", "m"), ("`fl`", "0.5")]
    assert list(markdown_table(rows, (1,)))[1:] == ["| --- | ---: |", "| `fl` | 0.5 |"]
    aligned = ["| name |   m |", "| ---- | --: |", "| `fl` | 0.5 |"]
    assert list(markdown_table(rows, (1,), aligned=True)) == aligned
    assert markdown_text("a_b | `c` <d>") == r"a\_b \| \`c\` &lt;d&gt;"
