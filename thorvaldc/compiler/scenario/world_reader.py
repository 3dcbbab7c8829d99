"""Reads the ground, the ground zones and the obstacles of the world in a scenario document."""

from __future__ import annotations

import math
from dataclasses import replace

from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.scenario.obstacle_reader import ObstacleReader
from thorvaldc.compiler.scenario.zone_reader import CELLS_PER_WAVE, MAX_CELLS, read_zones
from thorvaldc.compiler.source.edits import insertion, removal
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Ground, Robot, World

_KEYS_OF_SLOPES = ("angle", "direction")
_KEYS_OF_ROUGH_GROUND = ("amplitude", "wavelength", "seed", "size")
DEFAULT_SIZE = (30.0, 30.0)  # Default length and width of rough ground (m).


def read_world(document: Node, quantities: BoundedQuantities, report: Report) -> World:
    """Returns the world (ground, zones and obstacles) of a scenario document.

    The default world is level ground without obstacles.
    """
    node = document.get("world")
    if node is None:
        return World(Ground())
    ground = node.get("ground")
    obstacles = ObstacleReader(quantities, report, node)
    return World(
        _ground(ground, quantities, report) if ground is not None else Ground(),
        obstacles.blocks(),
        tuple(read_zones(node.get("zones"), quantities, report)),
    )


def wheel_friction(document: Node, quantities: BoundedQuantities) -> float | None:
    """Returns the friction coefficient that replaces the coefficients of all wheels.

    Returns ``None`` if the scenario document contains no friction coefficient of the world.
    """
    node = document.get("world")
    if node is None or node.get("friction") is None:
        return None
    return quantities(node, "friction", "number", 1.0, least=0.0, most=5.0, above=True)


def with_friction(robot: Robot, coefficient: float) -> Robot:
    """Returns a copy of the robot in which all wheels have the same friction coefficient."""
    wheels = (replace(wheel, friction=coefficient) for wheel in robot.wheels)
    return replace(robot, wheels=tuple(wheels))


def _ground(node: Node, quantities: BoundedQuantities, report: Report) -> Ground:
    """Reads the ground of the world, and reports keys that have no effect on the type of the
    ground.
    """
    type_node = node.get("type")
    ground_type = str(type_node.value) if type_node is not None else ""
    keys_without_effect = {
        "plane": (*_KEYS_OF_SLOPES, *_KEYS_OF_ROUGH_GROUND),
        "slope": _KEYS_OF_ROUGH_GROUND,
    }
    for key in keys_without_effect.get(ground_type, ()):
        entry = node.get(key)
        if entry is not None:
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
    amplitude, wavelength, seed, size = 0.0, 1.0, 0, DEFAULT_SIZE
    if ground_type == "rough":
        amplitude = quantities(node, "amplitude", "length", 0.02, least=0.0, most=1.0)
        wavelength = quantities(node, "wavelength", "length", 1.0, least=0.05, most=100.0)
        seed_node = node.get("seed")
        if seed_node is not None and isinstance(seed_node.value, int):
            seed = seed_node.value
        size = _rough_size(node, wavelength, quantities, report)
    return Ground(
        quantities(node, "angle", "angle", least=0.0, most=math.radians(60.0)),
        quantities(node, "direction", "angle"),
        amplitude,
        wavelength,
        seed,
        size,
    )


def _rough_size(
    node: Node, wavelength: float, quantities: BoundedQuantities, report: Report
) -> tuple[float, float]:
    """Returns the length and the width of rough ground (m).

    If rough ground has too many height field cells, the function reports an error and returns the
    default size.
    """
    size = quantities.pair(node, "size", DEFAULT_SIZE)
    cells = math.prod(edge / wavelength * CELLS_PER_WAVE for edge in size)
    if min(size) >= 1.0 and cells <= MAX_CELLS:
        return size
    report.add(
        "out-of-range",
        f"rough ground of {plain(size[0])} m x {plain(size[1])} m with waves of "
        f"{plain(wavelength)} m has {cells:.3g} cells; it must be at least 1 m long and have at "
        f"most {MAX_CELLS}",
        (node.get("size") or node).where,
        hint="choose longer waves, or less ground",
    )
    return DEFAULT_SIZE
