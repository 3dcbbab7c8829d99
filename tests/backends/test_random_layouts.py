"""Random layouts of frames in our DBC files, decoded by cantools as by our codec."""

from __future__ import annotations

import random

import pytest

from tests.backends.random_layouts import compare, read_by_cantools


def wrong_layouts(number: int, seed: int, *read: object) -> tuple[int, int]:
    """Returns the numbers of compared and of wrong layouts."""
    draw, compared, wrong = random.Random(seed), 0, 0
    while compared < number:
        for agrees in compare(draw, read):  # type: ignore[arg-type]
            compared += 1
            wrong += not agrees
    return compared, wrong


def test_cantools_decodes_and_encodes_random_layouts_as_the_driver() -> None:
    compared, wrong = wrong_layouts(400, 1, read_by_cantools)
    assert compared >= 400
    assert wrong == 0


@pytest.mark.slow
def test_cantools_agrees_in_10_000_layouts() -> None:
    assert wrong_layouts(10_000, 2, read_by_cantools)[1] == 0
