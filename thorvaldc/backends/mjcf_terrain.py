"""Height fields of rough ground and of height maps, in the binary format of MuJoCo."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.model import Ground, Pose, Zone

CELLS_PER_WAVE = 10
WAVES = 16
LEVEL, LEVEL_EDGE = 1.5, 1.0
"""Radius (m) of the level ground around the start of a robot, and width (m) of the transition."""
_CELL = 0.1
"""Largest cell (m) of the grid of a zone."""


class Relief(NamedTuple):
    """Heights of the ground on a grid.

    - ``center``, ``size``: centre of the grid (x, y) and its edge lengths along x and y in m.
    - ``low``, ``height``: height of the lowest point of the grid, and of the highest one above it,
      in m.
    - ``rows``: relative heights between 0 and 1, one row for each y coordinate.
    """

    center: tuple[float, float]
    size: tuple[float, float]
    low: float
    height: float
    rows: list[list[float]]


def relief_of(ground: Ground, starts: Sequence[Pose]) -> Relief:
    """Return the heights of rough ground, or of a height map."""
    heights = ground.heights
    if heights is not None:
        top = max(map(max, heights.rows))
        rows = [[height / top for height in row] for row in heights.rows]
        return Relief(heights.center, heights.size, 0.0, top, rows)
    rows = _bumps(ground, starts)
    return Relief((0.0, 0.0), ground.size, -ground.amplitude, 2.0 * ground.amplitude, rows)


def _bumps(ground: Ground, starts: Sequence[Pose]) -> list[list[float]]:
    """Return the relative heights of rough ground as a grid of numbers.

    The grid of heights has one row for each y coordinate. A relative height is the height divided
    by twice the amplitude of the bumps, and is between 0 and 1. The ground is level at half height
    around the start pose of each robot. At its edge, the rough ground descends to the relative
    height 0, where the surrounding plane begins.
    """
    xs, ys = (_grid(edge, ground.wavelength / CELLS_PER_WAVE) for edge in ground.size)
    rows = _waves(xs, ys, ground.wavelength, ground.seed)
    for row, y in zip(rows, ys, strict=True):
        near = [start for start in starts if abs(start.xyz[1] - y) < LEVEL + LEVEL_EDGE]
        for i, x in enumerate(xs):
            share = 1.0
            for start in near:
                away = math.hypot(x - start.xyz[0], y - start.xyz[1])
                share *= _step((away - LEVEL) / LEVEL_EDGE)
            inside = min(x - xs[0], xs[-1] - x, y - ys[0], ys[-1] - y)
            edge = _step(inside / ground.wavelength)
            row[i] = edge * (0.5 + 0.5 * share * row[i])
    # MuJoCo scales the heights of a height-field file to 0..1, so the grid must contain both 0, the
    # height of its edge, and 1.
    rows[0][-1] = 1.0
    return rows


def relief(zone: Zone) -> tuple[list[list[float]], float]:
    """Return the relative heights of a zone of the ground as a grid, and the largest height in m.

    The grid of heights has one row for each y coordinate. A relative height of the zone is the
    height divided by the largest height, and is between 0 and 1. A raised zone of the ground has
    sides that rise from its edge. The bumps of a zone reach their full height at a distance of half
    a wavelength from its edge.
    """
    cell = min(_CELL, min(zone.size) / 10)
    if zone.amplitude:
        cell = min(cell, zone.wavelength / CELLS_PER_WAVE)
    xs, ys = (_grid(edge, cell) for edge in zone.size)
    rows = _waves(xs, ys, zone.wavelength, zone.seed) if zone.amplitude else _level(xs, ys)
    rise = math.tan(zone.slope)
    for row, y in zip(rows, ys, strict=True):
        for i, x in enumerate(xs):
            inside = min(x - xs[0], xs[-1] - x, y - ys[0], ys[-1] - y)
            edge = _step(2.0 * inside / zone.wavelength)
            raised = min(zone.height, inside * rise)
            row[i] = raised + edge * zone.amplitude * (1.0 + row[i])
    top = max(max(row) for row in rows)
    return [[h / top for h in row] for row in rows], top


def _waves(
    xs: Sequence[float], ys: Sequence[float], wavelength: float, seed: int
) -> list[list[float]]:
    """Return random heights of the ground between -1 and 1 as a grid.

    The random heights are a normalised sum of plane waves with random directions and phases. The
    plane waves have wavelengths between ``wavelength`` and four times ``wavelength``. The amplitude
    of each plane wave is proportional to its wavelength.
    """
    random_numbers = random.Random(seed)
    rows = _level(xs, ys)
    for _ in range(WAVES):
        length = wavelength * 4.0 ** random_numbers.random()
        direction = random_numbers.uniform(0.0, math.tau)
        phase = random_numbers.uniform(0.0, math.tau)
        kx, ky = math.tau / length * math.cos(direction), math.tau / length * math.sin(direction)
        # sin(a + b) = sin a cos b + cos a sin b: the factors are the same in all rows or columns.
        sines = [length * math.sin(kx * x + phase) for x in xs]
        cosines = [length * math.cos(kx * x + phase) for x in xs]
        for row, y in zip(rows, ys, strict=True):
            s, c = math.sin(ky * y), math.cos(ky * y)
            row[:] = [h + a * c + b * s for h, a, b in zip(row, sines, cosines, strict=True)]
    largest = max(max(map(abs, row)) for row in rows) or 1.0
    for row in rows:
        row[:] = [h / largest for h in row]
    return rows


def _level(xs: Sequence[float], ys: Sequence[float]) -> list[list[float]]:
    return [[0.0] * len(xs) for _ in ys]


def _grid(edge: float, cell: float) -> list[float]:
    count = max(2, math.ceil(edge / cell - 1e-9))
    return [edge * (i / count - 0.5) for i in range(count + 1)]


def _step(share: float) -> float:
    """Return the smoothstep 3 s^2 - 2 s^3, where s is ``share`` limited to the range 0 to 1."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def height_file(rows: list[list[float]]) -> bytes:
    """Return the bytes of a MuJoCo height-field file, in little-endian order.

    A MuJoCo height-field file contains the numbers of rows and columns as int32, followed by the
    heights as float32.
    """
    import array
    import struct
    import sys

    values = array.array("f", [h for row in rows for h in row])
    if sys.byteorder == "big":
        values.byteswap()
    return struct.pack("<ii", len(rows), len(rows[0])) + values.tobytes()
