"""SDF files: a robot for Gazebo, and a world in which the robot stands.

The file ``model.sdf`` contains only the robot, so that a program can spawn it.  The file
``world.sdf`` contains the robots, the ground, the light and the systems of Gazebo that the robots
need, and does not include other files.

The files have the version 1.9 of SDF, which Gazebo Fortress and all newer versions read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from thorvaldc.backends import Backend
from thorvaldc.backends.colors_and_meshes import mesh_files
from thorvaldc.backends.sdf_robot import add_robot
from thorvaldc.backends.sdf_world import add_blocks, add_ground, add_systems
from thorvaldc.backends.urdf_only import urdf_only_elements
from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Fleet, Pose, Robot, World

VERSION = "1.9"


class Sdf(Backend):
    """Backend of the target `sdf`.

    For a fleet, the backend also writes one world with all robots.
    """

    name = "sdf"
    summary = "Gazebo model (sdf/model.sdf) and world (sdf/world.sdf) with its meshes"

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        return urdf_only_elements(robot, f"SDF {VERSION}", mimics=True)

    def emit(self, robot: Robot) -> dict[str, bytes]:
        return {
            "sdf/model.sdf": model_text(robot).encode(),
            "sdf/model.config": _config(robot),
            "sdf/world.sdf": _world(robot.name, [(robot, Pose(), "../meshes")], None)[0],
            **mesh_files(robot),
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
    add_robot(root, robot, None, meshes, share)
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
    root.add("name").text = robot.name
    root.add("version").text = "1.0"
    root.add("sdf", version=VERSION).text = "model.sdf"
    root.add("description").text = robot.description or robot.name
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
        add_robot(world, robot, pose, meshes)
    return to_bytes(root), files


def _empty_world(
    name: str, robots: Sequence[Robot], surroundings: World | None
) -> tuple[Element, Element]:
    """Return the root of a file and its world, with the systems of Gazebo."""
    root = Element("sdf", version=VERSION)
    world = root.add("world", name=name)
    add_systems(world, robots, surroundings)
    return root, world


def _add_surroundings(
    world: Element, surroundings: World | None, starts: Sequence[Pose]
) -> dict[str, bytes]:
    files = add_ground(world, surroundings, starts)
    if surroundings is not None:
        add_blocks(world, surroundings)
    return files
