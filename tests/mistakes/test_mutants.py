"""A fixed sample of valid documents with one human mistake each: the shares must not fall."""

from __future__ import annotations

import pytest

from tests.mistakes.mutants import KINDS, measure, shares, total


@pytest.mark.slow
def test_mistakes_are_seen_at_their_line_and_once() -> None:
    tallies = measure(count=2 * len(KINDS), seed=1)
    assert len(tallies) == len(KINDS)
    seen, near, single, restored = shares(total(tallies))
    assert seen >= 0.96
    assert near >= 0.93
    assert single >= 0.93
    assert restored >= 0.45
