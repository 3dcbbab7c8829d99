"""The examples compile to the very bytes that were reviewed."""

from __future__ import annotations

import difflib

import pytest

from tests.golden.outputs import EXAMPLES, GOLDEN, SUMS, expected_files, made_files


@pytest.mark.parametrize("example", EXAMPLES)
def test_outputs_are_those_that_were_reviewed(example: str) -> None:
    expected, made = expected_files(example), made_files(example)
    differences = []
    for path in [*sorted({*expected, *made} - {SUMS}), SUMS]:
        difference = difflib.unified_diff(
            expected.get(path, "").split("\n"),
            made.get(path, "").split("\n"),
            f"reviewed/{path}",
            f"now/{path}",
            lineterm="",
            n=1,
        )
        differences += list(difference)[:12]
    if differences:
        shown = "\n".join(line[:200] for line in differences[:60])
        pytest.fail(f"`make golden` rewrites, review what it changes:\n{shown}", pytrace=False)


def test_no_golden_files_without_an_example() -> None:
    assert {p.name for p in GOLDEN.iterdir() if p.is_dir() and p.name[0] != "_"} == set(EXAMPLES)
