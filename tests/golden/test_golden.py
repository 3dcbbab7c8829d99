"""The examples compile to exactly the bytes that were reviewed."""

from __future__ import annotations

import difflib

import pytest

from tests.golden.outputs import (
    EXAMPLES,
    GOLDEN,
    SUMS,
    current_files,
    expected_files,
    expected_sums,
)


@pytest.mark.parametrize("example", EXAMPLES)
def test_outputs_are_the_reviewed_ones(example: str) -> None:
    expected, (current, sums) = expected_files(example), current_files(example)
    paths = [*sorted({*expected, *current}), SUMS.name]
    expected[SUMS.name], current[SUMS.name] = expected_sums(example), sums
    differences = []
    for path in paths:
        difference = difflib.unified_diff(
            expected.get(path, "").split("\n"),
            current.get(path, "").split("\n"),
            f"reviewed/{path}",
            f"now/{path}",
            lineterm="",
            n=1,
        )
        differences += list(difference)[:12]
    if differences:
        shown = "\n".join(line[:200] for line in differences[:60])
        pytest.fail(
            f"the outputs changed; run `make golden` and review the differences:\n{shown}",
            pytrace=False,
        )


def test_no_golden_files_without_an_example() -> None:
    assert {p.name for p in GOLDEN.iterdir() if p.is_dir() and p.name[0] != "_"} == set(EXAMPLES)
    paths = [line.split()[1] for line in SUMS.read_text(encoding="utf-8").splitlines()]
    assert {path.split("/")[0] for path in paths} == set(EXAMPLES)
