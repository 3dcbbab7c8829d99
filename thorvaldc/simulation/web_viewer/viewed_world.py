"""The world of a fleet or scenario for the 3D viewer: fixed bodies, zones, slope and terrain."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from thorvaldc.backends.colors_and_meshes import BLOCK_COLORS, Color
from thorvaldc.backends.mjcf_terrain import heights, relief
from thorvaldc.backends.mjcf_world import zone_color
from thorvaldc.model import Box, Ground, Pose, Shape, World, Zone
from thorvaldc.model.spatial import quat_from_axis_angle
from thorvaldc.simulation.pictures.world_plot import zone_text
from thorvaldc.simulation.web_viewer.viewed_robot import base64_of, pose_values

GROUND_COLOR = (0.68, 0.64, 0.55, 1.0)
MAX_CELLS = 40_000
"""Largest number of cells of a height grid in the page."""
_PLATE = 0.004
"""Thickness in m of the plate of the first level zone.  Plates of later zones are thicker, so that
the last one is visible where zones overlap."""


def world_data(
    world: World, starts: Sequence[Pose], index: Callable[[Shape], int]
) -> dict[str, Any]:
    """Returns the data of a world that the viewer draws, as a JSON object.

    The poses are relative to the ground plane, which the viewer turns by ``tilt`` (quaternion
    wxyz).  Heights of reliefs are in m, row by row along y.

    Parameters
    ----------
    starts : start poses of the robots, around which rough ground is level.
    index : function that returns the index of the mesh of a shape.
    """
    bodies = [
        _body(block.kind, block.name, index(block.shape), block.pose, BLOCK_COLORS[block.kind])
        for block in world.blocks
    ]
    reliefs = []
    for number, zone in enumerate(world.zones, 1):
        if zone.level:
            plate = Box((*zone.size, _PLATE * (1.0 + number / len(world.zones))))
            text = zone_text(zone, ", ")
            bodies.append(_body("zone", text, index(plate), zone.pose, zone_color(zone)))
        else:
            reliefs.append(
                {
                    "kind": "zone",
                    "pose": pose_values(zone.pose),
                    "color": zone_color(zone),
                    **_zone_relief(zone),
                }
            )
    ground = world.ground
    if ground.amplitude:
        low = Pose((0.0, 0.0, -ground.amplitude))
        grid = _ground_relief(ground, tuple(starts))
        reliefs.append({"kind": "ground", "pose": pose_values(low), "color": GROUND_COLOR, **grid})
    axis = (math.sin(ground.direction), -math.cos(ground.direction), 0.0)
    return {
        "text": _text(world),
        "tilt": list(quat_from_axis_angle(axis, ground.angle)),
        "bodies": bodies,
        "reliefs": reliefs,
    }


def _body(kind: str, name: str, shape: int, pose: Pose, color: Color) -> dict[str, Any]:
    values = pose_values(pose)
    return {"kind": kind, "name": name, "shape": shape, "pose": values, "color": color}


# The same ground is drawn after each change of a file; random heights take some 0.1 s.
@functools.lru_cache(maxsize=8)
def _ground_relief(ground: Ground, starts: tuple[Pose, ...]) -> dict[str, Any]:
    return _relief(ground.size, heights(ground, starts), 2.0 * ground.amplitude)


@functools.lru_cache(maxsize=32)
def _zone_relief(zone: Zone) -> dict[str, Any]:
    rows, top = relief(zone)
    return _relief(zone.size, rows, top)


def _relief(size: tuple[float, float], rows: list[list[float]], top: float) -> dict[str, Any]:
    """Returns a height grid, of which every n-th row and column is left in a large one."""
    grid = top * np.asarray(rows)
    step = math.ceil(math.sqrt(grid.size / MAX_CELLS))
    ys, xs = (_samples(count, step) for count in grid.shape)
    return {
        "size": list(size),
        "rows": len(ys),
        "columns": len(xs),
        "heights": base64_of(grid[np.ix_(ys, xs)].astype("<f4")),
    }


def _samples(count: int, step: int) -> list[int]:
    """Returns about every ``step``-th index of ``count`` ones, with equal gaps and both ends."""
    return [int(i) for i in np.linspace(0, count - 1, max(2, math.ceil(count / step))).round()]


def _text(world: World) -> str:
    ground, parts = world.ground, []
    if ground.angle:
        uphill = math.degrees(ground.direction)
        parts.append(f"slope {math.degrees(ground.angle):.3g} deg (uphill at {uphill:.3g} deg)")
    if ground.amplitude:
        parts.append(f"bumps of {1e3 * ground.amplitude:.3g} mm")
    counts = Counter(block.kind for block in world.blocks)
    counts["zone"] = len(world.zones)
    parts += [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n]
    return ", ".join(parts)
