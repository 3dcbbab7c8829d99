"""Heights of rough ground: where it is level, how its edges descend, and its bumps."""

from __future__ import annotations

import array
import math
import random
import struct

import pytest

from thorvaldc.backends.mjcf_terrain import height_file, relief, relief_of
from thorvaldc.model import Ground, Pose, Zone

GROUND = Ground(amplitude=0.1, wavelength=2.0, seed=7, size=(12.0, 8.0))


def bumps(x: float, y: float, wavelength: float, seed: int) -> float:
    """The sum of plane waves that the module describes, before the normalisation."""
    numbers = random.Random(seed)
    height = 0.0
    for _ in range(16):
        length = wavelength * 4.0 ** numbers.random()
        direction = numbers.uniform(0.0, math.tau)
        phase = numbers.uniform(0.0, math.tau)
        along = x * math.cos(direction) + y * math.sin(direction)
        height += length * math.sin(math.tau * along / length + phase)
    return height


def grid(edge: float, cells: int) -> list[float]:
    return [edge * (k / cells - 0.5) for k in range(cells + 1)]


def test_ten_cells_for_each_wave() -> None:
    rows = relief_of(GROUND, []).rows
    assert (len(rows), len(rows[0])) == (41, 61)


def test_bumps_are_plane_waves_of_equal_steepness() -> None:
    rows = relief_of(GROUND, []).rows
    xs, ys = grid(12.0, 60), grid(8.0, 40)
    largest = max(abs(bumps(x, y, 2.0, 7)) for x in xs for y in ys)
    for row, y in list(zip(rows, ys, strict=True))[10:-10]:  # without the edge
        for height, x in list(zip(row, xs, strict=True))[10:-10]:
            assert height == pytest.approx(0.5 + 0.5 * bumps(x, y, 2.0, 7) / largest)


def test_the_edge_descends_within_one_wavelength() -> None:
    rows = relief_of(GROUND, []).rows
    xs, ys = grid(12.0, 60), grid(8.0, 40)
    largest = max(abs(bumps(x, y, 2.0, 7)) for x in xs for y in ys)
    for column, row in ((5, 20), (55, 20), (30, 5), (30, 35)):  # at half a wavelength
        inner = 0.5 + 0.5 * bumps(xs[column], ys[row], 2.0, 7) / largest
        assert rows[row][column] == pytest.approx(0.5 * inner)
    assert {*rows[-1], *(row[0] for row in rows), *(row[-1] for row in rows[1:])} == {0.0}
    # MuJoCo scales the heights to 0..1.
    assert rows[0] == [0.0] * 60 + [1.0]


def test_the_ground_is_level_around_each_start() -> None:
    ground = Ground(amplitude=0.1, wavelength=2.0, seed=7, size=(30.0, 20.0))
    rough = relief_of(ground, []).rows
    starts = (Pose((-6.0, 1.0, 0.0)), Pose((5.0, -3.0, 0.0)))
    rows = relief_of(ground, starts).rows
    for row, rough_row, y in zip(rows, rough, grid(20.0, 100), strict=True):
        for height, before, x in zip(row, rough_row, grid(30.0, 150), strict=True):
            away = min(math.hypot(x - s.xyz[0], y - s.xyz[1]) for s in starts)
            if away <= 1.5:
                assert height == pytest.approx(0.5)
            elif away >= 2.5:
                assert height == before
            elif abs(away - 2.0) < 1e-9:
                assert height - 0.5 == pytest.approx(0.5 * (before - 0.5))
    assert rows[55][75 - 30 + 10] == pytest.approx(0.5 + 0.5 * (rough[55][55] - 0.5))


def test_a_raised_zone_has_sides_of_its_slope() -> None:
    zone = Zone(Pose(), (4.0, 3.0), height=0.3, slope=math.radians(30))
    rows, top = relief(zone)
    assert top == 0.3
    assert (len(rows), len(rows[0])) == (31, 41)
    for row, y in zip(rows, grid(3.0, 30), strict=True):
        for height, x in zip(row, grid(4.0, 40), strict=True):
            inside = min(2.0 - abs(x), 1.5 - abs(y))
            assert height * top == pytest.approx(min(0.3, inside * math.tan(math.radians(30))))


def test_bumps_of_a_zone_rise_from_its_edge() -> None:
    zone = Zone(Pose(), (3.0, 2.0), amplitude=0.05, wavelength=0.5, seed=3)
    rows, top = relief(zone)
    xs, ys = grid(3.0, 60), grid(2.0, 40)
    assert (len(rows), len(rows[0])) == (41, 61)
    largest = max(abs(bumps(x, y, 0.5, 3)) for x in xs for y in ys)
    for row, y in zip(rows, ys, strict=True):
        for height, x in zip(row, xs, strict=True):
            share = min(2.0 * min(1.5 - abs(x), 1.0 - abs(y)) / 0.5, 1.0)
            edge = share * share * (3.0 - 2.0 * share)
            expected = 0.05 * edge * (1.0 + bumps(x, y, 0.5, 3) / largest)
            assert height * top == pytest.approx(expected, abs=1e-12)


def test_cells_of_a_narrow_zone() -> None:
    rows, _ = relief(Zone(Pose(), (0.5, 2.0), height=0.1, slope=1.0))
    assert (len(rows), len(rows[0])) == (41, 11)


def test_a_height_file_is_little_endian() -> None:
    data = height_file([[0.0, 0.25, 0.5], [0.75, 1.0, 0.125]])
    assert struct.unpack_from("<ii", data) == (2, 3)
    assert array.array("f", data[8:]).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0, 0.125]
