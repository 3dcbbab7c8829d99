"""SDF files: a robot for Gazebo, and a world in which the robot stands.

The file ``model.sdf`` contains only the robot, so that a program can spawn it.  The file
``world.sdf`` contains the robots, the ground, the light and the systems of Gazebo that the robots
need, and does not include other files.

The files have the version 1.9 of SDF, which Gazebo Fortress and all newer versions read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

from thorvaldc.backends import Backend, description_parts, sdf_extra_sensors, sdf_robot
from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.model import Fleet, Ground, Pose, Robot, World
from thorvaldc.model.sensor_numbers import WORLD_ORIGIN
from thorvaldc.model.statics.standing import stands_without_couplings
from thorvaldc.model.stl import Triangle, binary_stl

STEP = 0.001
"""Time step of the physics in s."""
TERRAIN = "terrain.stl"
_GROUND_SIZE = 200.0  # m, edge of the visible ground
_GROUND_COLOR = (0.5, 0.47, 0.4, 1.0)
_SYSTEMS = (
    ("physics", "Physics"),
    ("user-commands", "UserCommands"),
    ("scene-broadcaster", "SceneBroadcaster"),
)


class Sdf(Backend):
    """Backend of the target `sdf`.

    For a fleet, the backend also writes one world with all robots.
    """

    name = "sdf"
    summary = "Gazebo model (sdf/model.sdf) and world (sdf/world.sdf) with its meshes"

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        left_out = sdf_extra_sensors.left_out(robot)
        falls = not stands_without_couplings(robot)
        yield from description_parts.urdf_only_elements(
            robot, f"SDF {VERSION}", mimics=not falls, in_gazebo=left_out
        )
        if falls:
            coupled = [joint for joint in robot.joints if joint.mimic is not None]
            names = ", ".join(f"`{joint.name}`" for joint in coupled)
            yield Diagnostic(
                CODES["coupling-left-out"],
                f"SDF {VERSION} has no couplings: nothing couples {names} in Gazebo, and the robot"
                " does not stand there",
                coupled[0].span,
                "simulate it in MuJoCo",
            )

    def emit(self, robot: Robot) -> dict[str, bytes]:
        return {
            "sdf/model.sdf": model_text(robot).encode(),
            "sdf/model.config": _config(robot),
            "sdf/world.sdf": _world(robot.name, [(robot, Pose(), "../meshes")], None)[0],
            **description_parts.mesh_files(robot),
        }

    def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
        robots = [(p.robot, p.pose, f"../{p.name}/meshes") for p in fleet.placements]
        world, files = _world(fleet.name, robots, fleet.world)
        return {**super().emit_fleet(fleet), "sdf/world.sdf": world, **files}


def model_text(robot: Robot, meshes: str = "../meshes", share: str | None = None) -> str:
    """Return the SDF file of a robot as text, without a world.

    - ``meshes``: folder of the mesh files, relative to the file, or as a URI.
    - ``share``: shared folder of the ROS package, as a path or as the xacro expression
      ``$(find package)``. The model then has the plug-in of ros2_control, which reads
      ``config/controllers.yaml`` there, in place of Gazebo's controllers of single joints.
    """
    root = Element("sdf", version=VERSION)
    sdf_robot.add_robot(root, robot, None, meshes, share)
    return to_bytes(root).decode()


def world_files(
    name: str,
    robots: Sequence[Robot],
    surroundings: World | None = None,
    starts: Sequence[Pose] = (),
) -> dict[str, bytes]:
    """Return a world without robots, ``sdf/world.sdf``, and the mesh of rough ground.

    - ``robots``: robots that will be spawned; the world has the systems for their sensors.
    - ``starts``: poses of the robots: rough ground is level around them.
    """
    root, world = _empty_world(name, robots, surroundings)
    files = _add_surroundings(world, surroundings, starts)
    return {"sdf/world.sdf": to_bytes(root), **files}


def _config(robot: Robot) -> bytes:
    """Return the file by which Gazebo knows the folder ``sdf`` as a model."""
    root = Element("model")
    root.fill(name=robot.name, version="1.0")
    root.add("sdf", version=VERSION).text = "model.sdf"
    root.fill(description=robot.description or robot.name)
    return to_bytes(root)


def _world(
    name: str, robots: list[tuple[Robot, Pose, str]], surroundings: World | None
) -> tuple[bytes, dict[str, bytes]]:
    """Return the world file, and further files by path.

    Each robot has its pose in the world and the folder of its meshes.
    """
    root, world = _empty_world(name, [robot for robot, _, _ in robots], surroundings)
    files = _add_surroundings(world, surroundings, [pose for _, pose, _ in robots])
    for robot, pose, meshes in robots:
        sdf_robot.add_robot(world, robot, pose, meshes)
    return to_bytes(root), files


def _empty_world(
    name: str, robots: Sequence[Robot], surroundings: World | None
) -> tuple[Element, Element]:
    """Return the root of a file and its world, with the systems of Gazebo."""
    root = Element("sdf", version=VERSION)
    world = root.add("world", name=name)
    _add_systems(world, robots, surroundings)
    return root, world


def _add_surroundings(
    world: Element, surroundings: World | None, starts: Sequence[Pose]
) -> dict[str, bytes]:
    files = _add_ground(world, surroundings, starts)
    if surroundings is not None:
        _add_blocks(world, surroundings)
    return files


# -- the world: it is fixed to the ground; on a slope, gravity is inclined as in MuJoCo ---


def _add_systems(world: Element, robots: Sequence[Robot], surroundings: World | None) -> None:
    """Add physics, gravity, and the systems of Gazebo that the sensors of the robots need."""
    world.add("physics", name="physics", type="dart").fill(max_step_size=STEP, real_time_factor=1)
    ground = surroundings.ground if surroundings is not None else Ground()
    world.fill(gravity=description_parts.gravity_on(ground))
    for library, name in _SYSTEMS:
        sdf_robot.add_system(world, library, name)
    kinds = {sdf_robot.SENSORS.get(sensor.type) for robot in robots for sensor in robot.sensors}
    kinds |= {s.type for robot in robots for s in sdf_extra_sensors.extra_sensors(robot)}
    needed = {system for kind, system in sdf_extra_sensors.SYSTEMS.items() if kind in kinds}
    for system in dict.fromkeys(sdf_extra_sensors.SYSTEMS.values()):
        if system in needed:
            plugin = sdf_robot.add_system(world, *system)
            if system == sdf_extra_sensors.RENDERING:
                plugin.fill(render_engine="ogre2")
    if "navsat" in kinds:
        latitude, longitude, height = WORLD_ORIGIN
        coordinates = world.add("spherical_coordinates").fill(surface_model="EARTH_WGS84")
        coordinates.fill(latitude_deg=latitude, longitude_deg=longitude, elevation=height)


def _add_ground(
    world: Element, surroundings: World | None, starts: Sequence[Pose]
) -> dict[str, bytes]:
    """Add the sun and the ground, and return the mesh of rough ground by its path.

    ``starts`` lists the poses of the robots: rough ground is level around them.
    """
    world.add("light", name="sun", type="directional").fill(
        pose="0 0 10 0 0 0",
        cast_shadows=True,
        diffuse="0.8 0.8 0.8 1",
        specular="0.2 0.2 0.2 1",
        direction="-0.5 0.1 -0.9",
    )
    ground = surroundings.ground if surroundings is not None else Ground()
    link = _static_link(world, "ground")
    if ground.amplitude:
        sdf_robot.add_pose(link, Pose((0.0, 0.0, -ground.amplitude)))
    for part in _parts(link):
        plane = part.add("geometry").add("plane")
        plane.fill(normal="0 0 1", size=(_GROUND_SIZE, _GROUND_SIZE))
        if part.tag == "visual":
            sdf_robot.add_material(part, _GROUND_COLOR)
    if ground.even:
        return {}
    from thorvaldc.backends.mjcf_terrain import relief_of  # few builds need it

    relief = relief_of(ground, starts)
    link = _static_link(world, "terrain")
    if any(relief.center):
        sdf_robot.add_pose(link, Pose((*relief.center, 0.0)))
    for part in _parts(link):
        part.add("geometry").add("mesh").fill(uri=TERRAIN)
        if part.tag == "visual":
            sdf_robot.add_material(part, _GROUND_COLOR)
    rows = [[relief.low + relief.height * height for height in row] for row in relief.rows]
    return {f"sdf/{TERRAIN}": binary_stl(_triangles(rows, relief.size), bytes(80))}


def _add_blocks(world: Element, surroundings: World) -> None:
    """Add the fixed bodies of a scenario."""
    for block in surroundings.blocks:
        link = _static_link(world, f"{block.kind}_{block.name}")
        sdf_robot.add_pose(link, block.pose)
        for part in _parts(link):
            sdf_robot.add_geometry(part, block.shape, "")
            if part.tag == "visual":
                sdf_robot.add_material(part, description_parts.BLOCK_COLORS[block.kind])


def _static_link(world: Element, name: str) -> Element:
    return world.add("model", name=name).fill(static=True).add("link", name="link")


def _parts(link: Element) -> tuple[Element, Element]:
    return link.add("collision", name="collision"), link.add("visual", name="visual")


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


VERSION = "1.9"
