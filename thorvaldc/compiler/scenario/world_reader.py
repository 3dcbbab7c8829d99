"""Reads the ground, the ground zones and the obstacles of the world in a scenario document."""

from __future__ import annotations

import math
from dataclasses import replace

from thorvaldc.compiler.scenario.obstacle_reader import ObstacleReader
from thorvaldc.compiler.scenario.zone_reader import CELLS_PER_WAVE, MAX_CELLS, read_zones
from thorvaldc.compiler.source.node import insertion, removal
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Ground, Robot, World

_KEYS_OF_SLOPES = ("angle", "direction")
_KEYS_OF_ROUGH_GROUND = ("amplitude", "wavelength", "seed", "size")


def read_world(world: Section, report: Report) -> World:
    """Returns the world (ground, zones and obstacles) of a scenario document.

    The default world is level ground without obstacles.
    """
    ground = world["ground"]
    return World(
        _ground(ground, report) if "ground" in world else Ground(),
        ObstacleReader(world, report).blocks(),
        tuple(read_zones(world["zones"], report)),
    )


def with_friction(robot: Robot, coefficient: float) -> Robot:
    """Returns a copy of the robot in which all wheels have the same friction coefficient."""
    wheels = (replace(wheel, friction=coefficient) for wheel in robot.wheels)
    return replace(robot, wheels=tuple(wheels))


def _ground(ground: Section, report: Report) -> Ground:
    """Reads the ground of the world, and reports keys that have no effect on the type of the
    ground.
    """
    node, ground_type = ground.node, ground["type"]
    keys_without_effect = {
        "plane": (*_KEYS_OF_SLOPES, *_KEYS_OF_ROUGH_GROUND),
        "slope": _KEYS_OF_ROUGH_GROUND,
    }
    for key in keys_without_effect.get(ground_type, ()):
        entry = node.get(key)
        if entry is not None and "type" in ground:
            suitable_type = "rough" if key in _KEYS_OF_ROUGH_GROUND else "slope"
            report.add(
                "conflicting-keys",
                f"`{key}` has no effect on ground of type `{ground_type}`",
                entry.where,
                hint=removal(f"leave it out, or choose `type: {suitable_type}`", node, key),
            )
    if ground_type == "slope" and node.get("angle") is None:
        hint = insertion("add `angle: 10 deg`", node, "angle", "10 deg", is_example=True)
        report.add("missing-key", "a slope has no `angle`", node.where, hint=hint)
    slope = Ground(ground["angle"] or 0.0, ground["direction"])
    if ground_type != "rough":
        return slope
    _check_size(ground, report)
    rough = {key: ground[key] for key in _KEYS_OF_ROUGH_GROUND}
    return replace(slope, **rough)


def _check_size(ground: Section, report: Report) -> None:
    """Reports rough ground with too many cells of the height field, or without an extent."""
    size, wavelength = ground["size"], ground["wavelength"]
    cells = math.prod(edge / wavelength * CELLS_PER_WAVE for edge in size)
    if min(size) >= 1.0 and cells <= MAX_CELLS:
        return
    report.add(
        "out-of-range",
        f"rough ground of {plain(size[0])} m x {plain(size[1])} m with waves of "
        f"{plain(wavelength)} m has {cells:.3g} cells; it must be at least 1 m long and have at "
        f"most {MAX_CELLS}",
        ground.entry("size").where,
        hint="choose longer waves, or less ground",
    )
