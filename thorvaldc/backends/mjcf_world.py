"""The world of a scenario in MJCF: slope, bumps, zones and fixed bodies.

The world frame of the MuJoCo scene is fixed to the ground. For a slope, the MuJoCo scene has level
ground and an inclined gravity vector. The standing pose, the poses of the scenario and all
distances are therefore measured in the plane of the slope.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.backends.colors_and_meshes import BLOCK_COLORS
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model import Box, Cylinder, Ground, MeshShape, Pose, Sphere, World, Zone
from thorvaldc.model.spatial import GRAVITY, clean

TERRAIN = "terrain.bin"
_DEPTH = 0.5  # m, thickness of a height field below its lowest point
_FILM = 0.001  # m, half the thickness of the visible plate of a level zone
_LAYER = 0.0005  # m, added for each further zone: where zones overlap, the last one is visible
_SLIPPERY = 0.3  # coefficient of friction below which a zone has the colour of ice


def lowest(ground: Ground) -> float:
    """Return the height in m of the plane around and below the rough ground.

    The height of the plane is 0 for level ground.
    """
    return -ground.amplitude


def add_world(scene: Element, world: World, starts: Sequence[Pose]) -> dict[str, bytes]:
    """Add the world of a scenario to a MuJoCo scene, and return the height-field files by path.

    The MuJoCo scene must already contain the ground plane. ``starts`` lists the start poses of the
    robots. Rough ground is level around the start poses of the robots.
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
        geom.set(pos=block.pose.xyz, quat=block.pose.quat, rgba=BLOCK_COLORS[block.kind])
    files = _add_zones(scene, body, world.zones)
    if not ground.amplitude:
        return files
    from thorvaldc.backends.mjcf_terrain import height_file, heights  # few builds need it

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
    return {**files, f"mjcf/{TERRAIN}": height_file(heights(ground, starts))}


def _add_zones(scene: Element, body: Element, zones: Sequence[Zone]) -> dict[str, bytes]:
    """Add a plate for each level zone and a height field for each other zone.

    Returns the contents of the height-field files by path. The MJCF files do not contain the
    friction of zones. During a simulation, the program changes the friction of the wheels in a zone
    instead.
    """
    files = {}
    for number, zone in enumerate(zones, 1):
        x, y = zone.size
        geom = body.add("geom", pos=zone.pose.xyz, quat=zone.pose.quat, rgba=zone_color(zone))
        if zone.level:
            # The plate of a level zone is only visible and has no contacts, because the ground
            # plane carries the robots.
            geom.set(
                name=f"zone/{number}", type="box", size=(x / 2, y / 2, _FILM + number * _LAYER)
            )
            geom.set(contype=0, conaffinity=0, group=2)
            continue
        from thorvaldc.backends.mjcf_terrain import height_file, relief

        rows, top = relief(zone)
        name = f"zone_{number}"
        files[f"mjcf/{name}.bin"] = height_file(rows)
        scene.add("asset").add(
            "hfield", name=name, file=f"{name}.bin", size=(x / 2, y / 2, clean(top), _DEPTH)
        )
        geom.set(name=f"ground/{name}", type="hfield", hfield=name)
    return files


def zone_color(zone: Zone) -> tuple[float, float, float, float]:
    """Return the colour of a zone: red, green, blue and opacity, each 0 to 1."""
    if zone.friction is not None and zone.friction < _SLIPPERY:
        return (0.75, 0.87, 0.95, 1.0)
    return (0.62, 0.58, 0.48, 1.0) if zone.level else (0.72, 0.7, 0.62, 1.0)
