"""Reads the zones of the ground in a scenario, and checks the start poses of the robots."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from thorvaldc.compiler.source.node import Node, removal
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Fleet, Zone

MAX_CELLS = 1_000_000
CELLS_PER_WAVE = 10
"""Number of height field cells per wave of rough ground.

With fewer cells per wave, the edges between cells add rolling resistance.
"""
LARGEST_CELL = 0.1  # Largest edge length of a cell of the ground's height field (m).


def read_zones(zones: Iterable[Section], report: Report) -> Iterator[Zone]:
    """Yields each valid zone in the list `zones` of a scenario document."""
    for zone in zones:
        node, size = zone.node, zone["size"]
        amplitude, wavelength = zone["amplitude"], zone["wavelength"]
        cell = min(LARGEST_CELL, wavelength / CELLS_PER_WAVE) if amplitude else LARGEST_CELL
        count = math.prod(edge / cell for edge in size)
        if not (min(size) > 0.0 and count <= MAX_CELLS):
            report.add(
                "out-of-range",
                f"a zone of {plain(size[0])} m x {plain(size[1])} m has {count:.3g} cells; it must "
                f"have an extent, and at most {MAX_CELLS} cells",
                zone.entry("size").where,
            )
            continue
        _check_keys(node, report)
        yield Zone(
            zone.planar_pose(),
            size,
            zone["friction"],
            zone["rolling_resistance"],
            zone["height"],
            zone["slope"],
            amplitude,
            wavelength,
            zone["seed"],
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


def check_starts(fleet: Fleet, world: Section, report: Report) -> None:
    """Checks that no robot starts inside raised ground."""
    zone_sections = world["zones"]
    zones = fleet.world.zones if fleet.world is not None else ()
    if len(zone_sections) != len(zones):
        return  # A zone of the document is invalid.
    for section, zone in zip(zone_sections, zones, strict=True):
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
                    section.node.where,
                    hint="start it beside the zone, or at the height of the ground there",
                )
