"""Overlaps of convex polygons, for polygons whose overlap is known."""

from __future__ import annotations

import math

import pytest

from thorvaldc.model.statics.tip_over import overlap

Polygon = list[tuple[float, float]]
SQUARE: Polygon = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]


def moved(polygon: Polygon, x: float, y: float, turn: float = 0.0) -> Polygon:
    c, s = math.cos(turn), math.sin(turn)
    return [(c * px - s * py + x, s * px + c * py + y) for px, py in polygon]


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0, -1.2])
@pytest.mark.parametrize(
    ("place", "distance", "direction"),
    [
        ((1.5, 0.2), 0.5, (1.0, 0.0)),
        ((-1.7, 0.2), 0.3, (-1.0, 0.0)),
        ((0.3, 1.9), 0.1, (0.0, 1.0)),
        ((-0.3, -1.2), 0.8, (0.0, -1.0)),
    ],
)
def test_the_shortest_move_of_a_square(
    turn: float, place: tuple[float, float], distance: float, direction: tuple[float, float]
) -> None:
    (turned,) = moved([direction], 0.0, 0.0, turn)
    at = moved(SQUARE, *moved([place], 0.0, 0.0, turn)[0], turn)
    found = overlap(moved(SQUARE, 0.0, 0.0, turn), at)
    assert found is not None
    assert found[0] == pytest.approx(distance)
    assert found[1] == pytest.approx(turned)


def test_a_corner_that_reaches_over_an_edge() -> None:
    """The normal of an edge of the second polygon gives the shortest move."""
    diamond = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
    found = overlap(diamond, moved(SQUARE, 0.4, 0.4))
    assert found is not None
    assert found[0] == pytest.approx(0.2 / math.sqrt(2.0))
    assert found[1] == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))


@pytest.mark.parametrize("place", [(2.0, 0.0), (0.0, -2.5), (3.0, 3.0)])
def test_polygons_that_do_not_overlap(place: tuple[float, float]) -> None:
    assert overlap(SQUARE, moved(SQUARE, *place)) is None
