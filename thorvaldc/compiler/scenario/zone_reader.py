"""Reads the zones of the ground in a scenario, and checks the start poses of the robots."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.value_reader import items
from thorvaldc.compiler.source.edits import removal
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Fleet, Zone

MAX_CELLS = 1_000_000
CELLS_PER_WAVE = 10
"""Number of height field cells per wave of rough ground.

With fewer cells per wave, the edges between cells add rolling resistance.
"""
LARGEST_CELL = 0.1  # Largest edge length of a cell of the ground's height field (m).


def read_zones(node: Node | None, quantities: BoundedQuantities, report: Report) -> Iterator[Zone]:
    """Yields each valid zone in the list `zones` of a scenario document."""
    for zone_node in items(node):
        size = quantities.pair(zone_node, "size", (1.0, 1.0))
        amplitude = quantities(zone_node, "amplitude", "length", least=0.0, most=1.0)
        wavelength = quantities(zone_node, "wavelength", "length", 0.5, least=0.05, most=100.0)
        cell = min(LARGEST_CELL, wavelength / CELLS_PER_WAVE) if amplitude else LARGEST_CELL
        count = math.prod(edge / cell for edge in size)
        if not (min(size) > 0.0 and count <= MAX_CELLS):
            report.add(
                "out-of-range",
                f"a zone of {plain(size[0])} m x {plain(size[1])} m has {count:.3g} cells; it must "
                f"have an extent, and at most {MAX_CELLS} cells",
                (zone_node.get("size") or zone_node).where,
            )
            continue
        _check_keys(zone_node, report)
        seed = zone_node.get("seed")
        yield Zone(
            quantities.planar_pose(zone_node),
            size,
            _coefficient(zone_node, "friction", quantities, 5.0),
            _coefficient(zone_node, "rolling_resistance", quantities, 1.0),
            quantities(zone_node, "height", "length", least=0.0, most=10.0),
            quantities(
                zone_node,
                "slope",
                "angle",
                math.radians(10.0),
                least=0.01,
                most=math.radians(80.0),
            ),
            amplitude,
            wavelength,
            seed.value if seed is not None and isinstance(seed.value, int) else 0,
        )


def _check_keys(zone_node: Node, report: Report) -> None:
    """Reports each key of a ground zone that has no effect because another key is missing.

    For example, `wavelength` has no effect in a zone without `amplitude`.
    """
    for key, base in (("wavelength", "amplitude"), ("seed", "amplitude"), ("slope", "height")):
        entry = zone_node.get(key)
        if entry is not None and zone_node.get(base) is None:
            report.add(
                "conflicting-keys",
                f"`{key}` has no effect in a zone without `{base}`",
                entry.where,
                hint=removal(f"leave it out, or add `{base}`", zone_node, key),
            )


def _coefficient(node: Node, key: str, quantities: BoundedQuantities, most: float) -> float | None:
    """Returns the friction coefficient or the rolling resistance coefficient of a ground zone.

    Returns ``None`` if the ground zone does not change the coefficient of the wheels.
    """
    if node.get(key) is None:
        return None
    return quantities(node, key, "number", least=0.0, most=most)


def check_starts(fleet: Fleet, document: Node, report: Report) -> None:
    """Checks that no robot starts inside raised ground."""
    world = document.get("world")
    zone_nodes = items(world.get("zones") if world is not None else None)
    zones = fleet.world.zones if fleet.world is not None else ()
    if len(zone_nodes) != len(zones):
        # If a ground zone is invalid, the list of ground zones is shorter than the list of YAML
        # nodes.
        return
    for node, zone in zip(zone_nodes, zones, strict=True):
        if zone.level:
            continue
        for placement in fleet.placements:
            points = (placement.pose.apply((w.x, w.y, 0.0)) for w in placement.robot.wheels)
            if placement.pose.xyz[2] <= zone.pose.xyz[2] and any(
                zone.holds(x, y) for x, y, _ in points
            ):
                report.add(
                    "zone-under-robot",
                    f"{placement.name} starts inside raised ground",
                    node.where,
                    hint="start it beside the zone, or at the height of the ground there",
                )
