"""Static loads, compared with independent computations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from thorvaldc.model import Inertial
from thorvaldc.model.statics.static_loads import Pivot, static_loads

G = 9.81
coordinate = st.floats(-3.0, 3.0).map(lambda v: round(v, 3))
point = st.tuples(coordinate, coordinate)


def body(x: float, y: float, mass: float = 100.0) -> Inertial:
    return Inertial(mass, (x, y, 0.5), (1.0, 1.0, 1.0, 0.0, 0.0, 0.0))


def test_loads_of_three_wheels_follow_from_the_levers() -> None:
    loads = static_loads([(1.0, 0.5), (1.0, -0.5), (-1.0, 0.0)], body(0.5, 0.0))
    assert loads == pytest.approx([0.375 * 981, 0.375 * 981, 0.25 * 981])


def test_loads_of_four_wheels_are_in_a_plane() -> None:
    corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
    loads = static_loads(corners, body(0.2, 0.1))
    assert loads == pytest.approx([981 / 4 * (1 + 0.2 * x + 0.1 * y) for x, y in corners])


def test_single_wheel_carries_the_whole_weight() -> None:
    assert static_loads([(0.3, 0.2)], body(0.0, 0.0)) == pytest.approx([981.0])


def test_two_wheels_balance_the_moment_along_their_line() -> None:
    loads = static_loads([(1.0, 1.0), (-1.0, -1.0)], body(0.25, 0.25))
    assert loads == pytest.approx([0.625 * 981, 0.375 * 981])


def test_wheels_at_the_same_point_share_the_load() -> None:
    assert static_loads([(0.5, 0.5)] * 3, body(0.0, 0.0)) == pytest.approx([327.0] * 3)


def test_wheel_with_negative_load_carries_nothing() -> None:
    points = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0), (-4.0, 0.0)]
    loads = static_loads(points, body(0.8, 0.0))
    assert loads[4] == 0.0
    assert loads[:4] == pytest.approx(static_loads(points[:4], body(0.8, 0.0)))


def test_wheels_of_a_rocker_balance_about_its_pivot() -> None:
    points = [(1.0, 0.5), (1.0, -0.5), (-0.8, 0.0), (-1.4, 0.0)]
    pivot = Pivot((0.0, 0.0, -0.2, 0.4), 0.0)  # about y at x = -1
    loads = static_loads(points, body(0.0, 0.1), [pivot])
    assert loads == pytest.approx([0.35 * 981, 0.15 * 981, 981 / 3, 981 / 6])


def test_wheels_on_a_line_through_the_origin_with_a_pivot() -> None:
    """All x are 0, so that the balance about y is 0 = 0."""
    points = [(0.0, 0.6), (0.0, -0.2), (0.0, -0.6)]
    rocker = Pivot((0.0, 0.2, -0.2), 0.0)  # of the second and the third wheel
    loads = static_loads(points, body(0.0, 0.1), [rocker])
    assert loads[1] == pytest.approx(loads[2])
    assert sum(loads) == pytest.approx(981)
    assert 0.6 * loads[0] - 0.2 * loads[1] - 0.6 * loads[2] == pytest.approx(98.1)


def test_pivot_of_balanced_wheels_changes_no_load() -> None:
    points = [(1.0, 0.5), (1.0, -0.5), (-1.0, 0.5), (-1.0, -0.5)]
    tractor = Pivot((0.5, -0.5, 0.0, 0.0), 0.0)  # a front axle that rolls about x
    assert static_loads(points, body(0.3, 0.0), [tractor]) == pytest.approx(
        static_loads(points, body(0.3, 0.0))
    )


@settings(deadline=None, max_examples=100)
@given(st.lists(point, min_size=3, max_size=12, unique=True), st.data())
def test_loads_equal_those_of_equal_springs_under_a_rigid_body(
    points: list[tuple[float, float]], data: st.DataObject
) -> None:
    """The loads have the least energy of equal springs under the balance of force and moments."""
    matrix = np.array([[1.0, x, y] for x, y in points])
    assume(np.linalg.cond(matrix) < 1e4)
    shares = np.array(data.draw(st.tuples(*[st.floats(0.05, 1.0)] * len(points))))
    shares /= shares.sum()
    x, y = shares @ matrix[:, 1:]
    loads = static_loads(points, body(x, y))
    balance = 981.0 * np.array([1.0, x, y])
    least, *_ = np.linalg.lstsq(matrix.T, balance, rcond=None)
    if least.min() > 1e-6:
        np.testing.assert_allclose(loads, least, rtol=1e-6, atol=1e-6)
    assert min(loads) >= 0.0
    np.testing.assert_allclose(matrix.T @ loads, balance, rtol=1e-6, atol=1e-5)


@settings(deadline=None, max_examples=50)
@given(
    st.lists(point, min_size=3, max_size=8, unique=True),
    coordinate,
    coordinate,
    st.floats(-math.pi, math.pi),
)
def test_loads_do_not_depend_on_the_origin(
    points: list[tuple[float, float]], dx: float, dy: float, turn: float
) -> None:
    matrix = np.array([[1.0, x, y] for x, y in points])
    assume(np.linalg.cond(matrix) < 1e3)
    x, y = np.mean(points, axis=0)
    c, s = math.cos(turn), math.sin(turn)

    def moved(px: float, py: float) -> tuple[float, float]:
        return (c * px - s * py + dx, s * px + c * py + dy)

    loads_at_origin = static_loads(points, body(x, y))
    loads_elsewhere = static_loads([moved(*p) for p in points], body(*moved(x, y)))
    assert loads_elsewhere == pytest.approx(loads_at_origin, rel=1e-6, abs=1e-6)
