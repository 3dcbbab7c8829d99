"""Zones of a scenario's ground, and that no robot starts within what rises."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Zone

MAX_CELLS = 1_000_000
CELLS_PER_WAVE = 10
"""Cells of rough ground along a wave: the fewer, the more it resists rolling."""


def read_zones(listed: Node | None, numbers: BoundedQuantities, report: Report) -> Iterator[Zone]:
    items = listed.value if listed is not None else None
    for node in items if isinstance(items, tuple) else ():
        size = numbers.pair(node, "size", (1.0, 1.0))
        amplitude = numbers(node, "amplitude", "length", least=0.0, most=1.0)
        wavelength = numbers(node, "wavelength", "length", 0.5, least=0.05, most=100.0)
        cell = min(0.1, wavelength / CELLS_PER_WAVE) if amplitude else 0.1
        count = math.prod(edge / cell for edge in size)
        if not (min(size) > 0.0 and count <= MAX_CELLS):
            report.add(
                "out-of-range",
                f"a zone of {size[0]:g} m x {size[1]:g} m has {count:.3g} cells; it must have "
                f"an extent, and at most {MAX_CELLS} cells",
                (node.get("size") or node).where,
            )
            continue
        for key, of in (("wavelength", "amplitude"), ("seed", "amplitude"), ("slope", "height")):
            entry = node.get(key)
            if entry is not None and node.get(of) is None:
                report.add(
                    "conflicting-keys",
                    f"`{key}` says nothing of a zone without `{of}`",
                    entry.where,
                    hint=f"leave it out, or add `{of}`",
                )
        seed = node.get("seed")
        yield Zone(
            numbers.planar_pose(node),
            size,
            _own(node, "friction", numbers, 5.0),
            _own(node, "rolling_resistance", numbers, 1.0),
            numbers(node, "height", "length", least=0.0, most=10.0),
            numbers(
                node, "slope", "angle", math.radians(10.0), least=0.01, most=math.radians(80.0)
            ),
            amplitude,
            wavelength,
            seed.value if seed is not None and isinstance(seed.value, int) else 0,
        )


def _own(node: Node, key: str, numbers: BoundedQuantities, most: float) -> float | None:
    if node.get(key) is None:
        return None
    return numbers(node, key, "number", least=0.0, most=most)


def check_starts(fleet: Fleet, document: Node, report: Report) -> None:
    """That no robot starts in ground that rises, but on top of it."""
    world = document.get("world")
    listed = world.get("zones") if world is not None else None
    items = listed.value if listed is not None else None
    zones = fleet.world.zones if fleet.world is not None else ()
    if not isinstance(items, tuple) or len(items) != len(zones):
        return
    for node, zone in zip(items, zones, strict=True):
        if zone.level:
            continue
        for placement in fleet.placements:
            points = (placement.pose.apply((w.x, w.y, 0.0)) for w in placement.robot.wheels)
            if placement.pose.xyz[2] <= zone.pose.xyz[2] and any(
                zone.holds(x, y) for x, y, _ in points
            ):
                report.add(
                    "zone-under-robot",
                    f"{placement.name} starts within ground that rises",
                    node.where,
                    hint="start it beside, or as high as the ground is there",
                )
