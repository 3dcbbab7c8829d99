"""The world of a scenario in MJCF: slope, bumps, and what stands around.

The scene's frame is the ground's: on a slope it is gravity that leans, so that robots
settle, poses are given and ways are measured in the plane that is driven on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.backends.stance import GRAVITY
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model import Box, Cylinder, Ground, MeshShape, Pose, Sphere, World
from thorvaldc.model.spatial import clean

TERRAIN = "terrain.bin"
CELLS_PER_WAVE = 10
WAVES = 16
LEVEL, LEVEL_EDGE = 1.5, 1.0
"""Robots start in the middle of level ground of this radius (m), which ends over this width."""
_DEPTH = 0.5  # m, of the ground below its lowest point
_COLORS = {
    "kerb": (0.62, 0.62, 0.6, 1.0),
    "rail": (0.45, 0.47, 0.5, 1.0),
    "obstacle": (0.7, 0.35, 0.2, 1.0),
    "crop": (0.25, 0.5, 0.2, 1.0),
    "post": (0.75, 0.77, 0.8, 1.0),
}


def lowest(ground: Ground) -> float:
    """Height (m) of the plane around and below rough ground; 0 where there is none."""
    return -ground.amplitude


def add_world(scene: Element, world: World, starts: Sequence[Pose]) -> dict[str, bytes]:
    """Add the world to a scene that has a plane; what files it needs, by path.

    Robots stand at ``starts``.
    """
    ground = world.ground
    if ground.angle:
        down = GRAVITY * math.sin(ground.angle)
        x, y = math.cos(ground.direction), math.sin(ground.direction)
        lean = (clean(-down * x), clean(-down * y), clean(-GRAVITY * math.cos(ground.angle)))
        scene.add("option", gravity=lean)
    body = scene.add("worldbody")
    for block in world.blocks:
        geom = body.add("geom", name=f"{block.kind}/{block.name}")
        shape = block.shape
        if isinstance(shape, Box):
            x, y, z = shape.size
            geom.set(type="box", size=(x / 2, y / 2, z / 2))
        elif isinstance(shape, Cylinder):
            geom.set(type="cylinder", size=(shape.radius, shape.length / 2))
        elif isinstance(shape, Sphere):
            geom.set(type="sphere", size=(shape.radius,))
        elif isinstance(shape, MeshShape):
            raise TypeError("a block has no mesh")
        geom.set(pos=block.pose.xyz, quat=block.pose.quat, rgba=_COLORS[block.kind])
    if not ground.amplitude:
        return {}
    x, y = ground.size
    scene.add("asset").add(
        "hfield",
        name="terrain",
        file=TERRAIN,
        size=(x / 2, y / 2, 2 * ground.amplitude, _DEPTH),
    )
    body.add(
        "geom",
        name="ground/terrain",
        type="hfield",
        hfield="terrain",
        pos=(0, 0, -ground.amplitude),
        material="ground",
    )
    return {f"mjcf/{TERRAIN}": _file(heights(ground, starts))}


def heights(ground: Ground, starts: Sequence[Pose]) -> list[list[float]]:
    """Heights over the lowest point, over twice the amplitude: 0..1, rows along y.

    A sum of plane waves of random directions, ``wavelength`` to four times as long, as
    high as they are long.  Level at half height where robots start, and down to 0
    along the edge, where the plane around begins.
    """
    import random  # which few builds need

    chance = random.Random(ground.seed)
    xs, ys = (_grid(edge, ground.wavelength) for edge in ground.size)
    rows = [[0.0] * len(xs) for _ in ys]
    for _ in range(WAVES):
        length = ground.wavelength * 4.0 ** chance.random()
        way, phase = chance.uniform(0.0, math.tau), chance.uniform(0.0, math.tau)
        kx, ky = (math.tau / length * part for part in (math.cos(way), math.sin(way)))
        # sin(a + b) by the sines of a and b, which rows and columns share.
        sines = [length * math.sin(kx * x + phase) for x in xs]
        cosines = [length * math.cos(kx * x + phase) for x in xs]
        for row, y in zip(rows, ys, strict=True):
            s, c = math.sin(ky * y), math.cos(ky * y)
            row[:] = [h + a * c + b * s for h, a, b in zip(row, sines, cosines, strict=True)]
    largest = max(max(map(abs, row)) for row in rows) or 1.0
    for row, y in zip(rows, ys, strict=True):
        near = [start for start in starts if abs(start.xyz[1] - y) < LEVEL + LEVEL_EDGE]
        for i, x in enumerate(xs):
            share = 1.0
            for start in near:
                away = math.hypot(x - start.xyz[0], y - start.xyz[1])
                share *= _step((away - LEVEL) / LEVEL_EDGE)
            inside = min(x - xs[0], xs[-1] - x, y - ys[0], ys[-1] - y)
            edge = _step(inside / ground.wavelength)
            row[i] = edge * (0.5 + 0.5 * share * row[i] / largest)
    # MuJoCo stretches what it reads to 0..1: both ends must be there.
    rows[0][0], rows[0][-1] = 0.0, 1.0
    return rows


def _grid(edge: float, wavelength: float) -> list[float]:
    cells = max(2, math.ceil(edge / wavelength * CELLS_PER_WAVE))
    return [edge * (i / cells - 0.5) for i in range(cells + 1)]


def _step(share: float) -> float:
    """0 up to 0, 1 from 1 on, smooth between."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def _file(rows: list[list[float]]) -> bytes:
    """MuJoCo's own format: numbers of rows and columns, then heights, little endian."""
    import array
    import struct
    import sys

    values = array.array("f", [h for row in rows for h in row])
    if sys.byteorder == "big":
        values.byteswap()
    return struct.pack("<ii", len(rows), len(rows[0])) + values.tobytes()
