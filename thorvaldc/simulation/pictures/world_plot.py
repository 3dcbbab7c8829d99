"""Draws the world of a fleet or scenario, seen from above: zones, fixed bodies and the slope."""

from __future__ import annotations

import math
from typing import Any

from thorvaldc.model import Robot, World, Zone

BODY, ZONE = "#8c6d46", "#c6dbef"
_FLAT = math.radians(0.1)
"""Slope below which no arrow is drawn."""
_CORNERS = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))


def draw_world(axes: Any, world: World, robot: Robot) -> None:
    """Draws the world under the paths; the limits of the axes are left to the paths.

    ``robot``: any robot of the scene, whose meshes bodies may use.
    """
    for zone in world.zones:
        _draw_zone(axes, zone)
    _draw_bodies(axes, world, robot)
    ground = world.ground
    if abs(ground.angle) > _FLAT:
        # The arrow points uphill.
        dx, dy = math.cos(ground.direction), math.sin(ground.direction)
        axes.annotate(
            "",
            xy=(0.08 + 0.04 * dx, 0.92 + 0.04 * dy),
            xytext=(0.08 - 0.04 * dx, 0.92 - 0.04 * dy),
            xycoords="axes fraction",
            arrowprops={"arrowstyle": "-|>", "color": BODY},
        )
        text = f"rises by {math.degrees(ground.angle):.3g} deg"
        axes.text(0.14, 0.92, text, transform=axes.transAxes, va="center", fontsize=8, color=BODY)


def _draw_zone(axes: Any, zone: Zone) -> None:
    from matplotlib.patches import Polygon

    corners = [zone.pose.apply((x * zone.size[0], y * zone.size[1], 0.0))[:2] for x, y in _CORNERS]
    axes.add_patch(Polygon(corners, facecolor=ZONE, edgecolor="#6baed6", lw=0.6, zorder=0.5))
    text = zone_text(zone)
    if text:
        axes.text(*zone.pose.xyz[:2], text, fontsize=7, ha="center", va="center", clip_on=True)


def zone_text(zone: Zone, separator: str = "\n") -> str:
    """Returns what differs in a zone from the ground around it."""
    parts = [f"friction {zone.friction:.3g}"] if zone.friction is not None else []
    if zone.rolling_resistance is not None:
        parts.append(f"rolling resistance {zone.rolling_resistance:.3g}")
    if zone.height:
        parts.append(f"height {zone.height:.3g} m")
    return separator.join(parts)


def _draw_bodies(axes: Any, world: World, robot: Robot) -> None:
    from matplotlib.patches import Polygon

    from thorvaldc.simulation.pictures.surfaces import outline_from_above

    for block in world.blocks:
        outline, _ = outline_from_above(robot, block.shape, block.pose)
        axes.add_patch(
            Polygon(
                outline,
                facecolor=BODY,
                edgecolor="#303030",
                lw=0.4,
                alpha=0.6,
                zorder=1.0,
            )
        )
