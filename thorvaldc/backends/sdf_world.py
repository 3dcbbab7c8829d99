"""The world of an SDF file: systems, ground, light and fixed bodies.

The world frame is fixed to the ground.  For a slope, the world has level ground and an inclined
gravity vector, as the MuJoCo scene has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from thorvaldc.backends.colors_and_meshes import BLOCK_COLORS
from thorvaldc.backends.sdf_elements import add_geometry, add_pose, add_system
from thorvaldc.backends.sdf_sensors import SENSORS
from thorvaldc.backends.xml_writer import Element, number, numbers
from thorvaldc.model import Ground, Pose, Robot, World
from thorvaldc.model.spatial import GRAVITY, clean
from thorvaldc.model.stl import Triangle, binary_stl

STEP = 0.001
"""Time step of the physics in s."""
TERRAIN = "terrain.stl"
_GROUND_SIZE = 200.0  # m, edge of the visible ground
_GROUND_COLOR = (0.5, 0.47, 0.4, 1.0)
_FIELD = (("latitude_deg", 59.665), ("longitude_deg", 10.775), ("elevation", 90.0))
"""Origin of the world for GNSS receivers: a field in As, Norway."""
_SYSTEMS = (
    ("physics", "Physics"),
    ("user-commands", "UserCommands"),
    ("scene-broadcaster", "SceneBroadcaster"),
)


def add_systems(world: Element, robots: Sequence[Robot], surroundings: World | None) -> None:
    """Add physics, gravity, and the systems of Gazebo that the sensors of the robots need."""
    physics = world.add("physics", name="physics", type="dart")
    physics.add("max_step_size").text = number(STEP)
    physics.add("real_time_factor").text = "1"
    ground = surroundings.ground if surroundings is not None else Ground()
    world.add("gravity").text = numbers(_gravity(ground))
    for library, name in _SYSTEMS:
        add_system(world, library, name)
    kinds = {SENSORS.get(sensor.type) for robot in robots for sensor in robot.sensors}
    if kinds & {"gpu_lidar", "camera"}:
        sensors = add_system(world, "sensors", "Sensors")
        sensors.add("render_engine").text = "ogre2"
    if "imu" in kinds:
        add_system(world, "imu", "Imu")
    if "navsat" in kinds:
        add_system(world, "navsat", "NavSat")
        coordinates = world.add("spherical_coordinates")
        coordinates.add("surface_model").text = "EARTH_WGS84"
        for name, value in _FIELD:
            coordinates.add(name).text = number(value)


def _gravity(ground: Ground) -> tuple[float, float, float]:
    down = GRAVITY * math.sin(ground.angle)
    x, y = math.cos(ground.direction), math.sin(ground.direction)
    return clean(-down * x), clean(-down * y), clean(-GRAVITY * math.cos(ground.angle))


def add_ground(
    world: Element, surroundings: World | None, starts: Sequence[Pose]
) -> dict[str, bytes]:
    """Add the sun and the ground, and return the mesh of rough ground by its path.

    ``starts`` lists the poses of the robots: rough ground is level around them.
    """
    sun = world.add("light", name="sun", type="directional")
    sun.add("pose").text = "0 0 10 0 0 0"
    sun.add("cast_shadows").text = "true"
    sun.add("diffuse").text = "0.8 0.8 0.8 1"
    sun.add("specular").text = "0.2 0.2 0.2 1"
    sun.add("direction").text = "-0.5 0.1 -0.9"
    ground = surroundings.ground if surroundings is not None else Ground()
    link = _static_link(world, "ground")
    if ground.amplitude:
        add_pose(link, Pose((0.0, 0.0, -ground.amplitude)))
    for part in _parts(link):
        plane = part.add("geometry").add("plane")
        plane.add("normal").text = "0 0 1"
        plane.add("size").text = numbers((_GROUND_SIZE, _GROUND_SIZE))
        if part.tag == "visual":
            _add_material(part, _GROUND_COLOR)
    if not ground.amplitude:
        return {}
    from thorvaldc.backends.mjcf_terrain import heights  # few builds need it

    link = _static_link(world, "terrain")
    for part in _parts(link):
        part.add("geometry").add("mesh").add("uri").text = TERRAIN
        if part.tag == "visual":
            _add_material(part, _GROUND_COLOR)
    scaled = [
        [ground.amplitude * (2.0 * height - 1.0) for height in row]
        for row in heights(ground, starts)
    ]
    return {f"sdf/{TERRAIN}": binary_stl(_triangles(scaled, ground.size), bytes(80))}


def add_blocks(world: Element, surroundings: World) -> None:
    """Add the fixed bodies of a scenario."""
    for block in surroundings.blocks:
        link = _static_link(world, f"{block.kind}_{block.name}")
        add_pose(link, block.pose)
        for part in _parts(link):
            add_geometry(part, block.shape, "")
            if part.tag == "visual":
                _add_material(part, BLOCK_COLORS[block.kind])


def _static_link(world: Element, name: str) -> Element:
    model = world.add("model", name=name)
    model.add("static").text = "true"
    return model.add("link", name="link")


def _parts(link: Element) -> tuple[Element, Element]:
    return link.add("collision", name="collision"), link.add("visual", name="visual")


def _add_material(visual: Element, color: tuple[float, float, float, float]) -> None:
    material = visual.add("material")
    for name in ("ambient", "diffuse"):
        material.add(name).text = numbers(color)


def _triangles(rows: Sequence[Sequence[float]], size: tuple[float, float]) -> Iterator[Triangle]:
    """Yield the triangles of a grid of heights in m, two for each cell.

    ``rows`` has one row for each y coordinate; ``size`` has the edges along x and y in m.
    """
    ny, nx = len(rows) - 1, len(rows[0]) - 1
    points = [
        [(size[0] * (i / nx - 0.5), size[1] * (j / ny - 0.5), z) for i, z in enumerate(row)]
        for j, row in enumerate(rows)
    ]
    for low, high in pairwise(points):
        for (a, b), (d, c) in zip(pairwise(low), pairwise(high), strict=True):
            yield a, b, c
            yield a, c, d
