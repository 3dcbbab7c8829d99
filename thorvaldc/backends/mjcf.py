"""MJCF files: a robot for MuJoCo, and a scene in which the robot stands at rest.

The file ``robot.xml`` contains only the robot and can be included in other models. The file
``scene.xml`` adds the ground, the light and the key frame ``home``.

The MuJoCo settings of contacts and servos are chosen for wheeled robots of 100 to 400 kg and time
steps of 1 to 5 ms. Reasons why a simulated robot slides, rolls and stands on slopes like a real
robot:

- The friction cones are elliptic.
- The first value of ``solimp`` is near zero.
- The drives hold their position at zero speed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from thorvaldc.backends.colors_and_meshes import mesh_files
from thorvaldc.backends.mjcf_robot import RobotWriter
from thorvaldc.backends.mjcf_scene import add_home, add_surroundings
from thorvaldc.backends.mjcf_sections import ModelSections
from thorvaldc.backends.mjcf_world import add_world
from thorvaldc.backends.statics_backend import StaticsBackend
from thorvaldc.backends.urdf_only import urdf_only_elements
from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Fleet, MeshShape, Pose, Robot
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.standing_pose import Statics, solve_statics


class Mjcf(StaticsBackend):
    """Backend of the target `mjcf`: writes ``robot.xml`` and ``scene.xml``.

    For a fleet, the backend also writes one MuJoCo scene with all robots.
    """

    name = "mjcf"
    summary = "MuJoCo model (mjcf/robot.xml) and scene (mjcf/scene.xml) with its meshes"

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        return urdf_only_elements(robot, "MJCF")

    def emit_with_statics(self, robot: Robot, statics: Statics) -> dict[str, bytes]:
        return {**_robot_and_scene(robot, statics), **mesh_files(robot)}

    def emit_fleet_with_statics(self, fleet: Fleet, statics: Sequence[Statics]) -> dict[str, bytes]:
        files = super().emit_fleet_with_statics(fleet, statics)
        return files | _fleet_scene(fleet, statics)


def simulation_files(fleet: Fleet) -> dict[str, bytes]:
    """Return the scene of a fleet without visual shapes, and the meshes of its collision shapes,
    by path.

    The physics is that of the target `mjcf`. A study or a batch of scenarios simulates thousands of
    fleets that nobody looks at, and MuJoCo would read all meshes before it discards them.
    """
    statics = [solve_statics(placement.robot) for placement in fleet.placements]
    files = _fleet_scene(fleet, statics, visuals=False)
    for placement in fleet.placements:
        robot = placement.robot
        shapes = [collision.shape for link in robot.links for collision in link.collisions]
        used = {f"meshes/{shape.mesh}" for shape in shapes if isinstance(shape, MeshShape)}
        for path, data in mesh_files(robot).items():
            if path in used:
                files[f"{placement.name}/{path}"] = data
    return files


def _fleet_scene(
    fleet: Fleet, statics: Sequence[Statics], *, visuals: bool = True
) -> dict[str, bytes]:
    robots = [placement.robot for placement in fleet.placements]
    poses = [placement.pose for placement in fleet.placements]
    folders = [f"../{placement.name}/meshes" for placement in fleet.placements]
    sections = ModelSections(fleet.name, robots, folders)
    trees = [tree_of(robot) for robot in robots]
    for i, robot in enumerate(robots):
        RobotWriter(sections, robot, trees[i], i, statics[i], visuals=visuals).write(poses[i])
    scene = sections.root()
    add_surroundings(scene, robots, poses, fleet.world)
    files = {} if fleet.world is None else add_world(scene, fleet.world, poses)
    add_home(scene, robots, trees, statics, poses)
    return files | {"mjcf/scene.xml": to_bytes(scene)}


def ros2_control_files(robot: Robot) -> dict[str, bytes]:
    """Return robot and scene for mujoco_ros2_control, by path; their meshes are in ``meshes/``.

    This program takes every actuator with a position gain for a position servo, such as
    ``intvelocity``. In these files, the drives are ``velocity`` servos.
    """
    return _robot_and_scene(robot, solve_statics(robot), velocity_servos=True)


def _robot_and_scene(
    robot: Robot, statics: Statics, *, velocity_servos: bool = False
) -> dict[str, bytes]:
    tree = tree_of(robot)
    sections = ModelSections(robot.name, [robot], ["../meshes"])
    writer = RobotWriter(sections, robot, tree, 0, statics, velocity_servos=velocity_servos)
    writer.write(None)
    scene = Element("mujoco", model=f"{robot.name} scene")
    scene.add("include", file="robot.xml")
    add_surroundings(scene, [robot], [Pose()])
    home = ([robot], [tree], [statics], [Pose()])
    add_home(scene, *home, velocity_servos=velocity_servos)
    return {"mjcf/robot.xml": to_bytes(sections.root()), "mjcf/scene.xml": to_bytes(scene)}
