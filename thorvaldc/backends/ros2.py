"""The target `ros2`: an ament_python package that starts the robot in ROS 2.

The folder ``ros2/`` of a build is the package. The page docs/ros2.md describes it. Its parts are in
the modules whose names begin with ``ros2_``, and the texts that are not parameters in the folder
``templates/ros2``.
"""

from __future__ import annotations

import posixpath

from thorvaldc.backends import Backend
from thorvaldc.backends.mjcf import ros2_control_files
from thorvaldc.backends.ros2_control_files import (
    control_files,
    control_packages,
    left_out_of_control,
)
from thorvaldc.backends.ros2_launch_files import fleet_launch_file, launch_files
from thorvaldc.backends.ros2_localization import (
    ekf_map,
    ekf_odom,
    navsat_transform,
    slam_toolbox,
)
from thorvaldc.backends.ros2_navigation import global_costmap, nav2, plugin_packages
from thorvaldc.backends.ros2_package_files import (
    driver_module,
    fleet_readme,
    package_files,
    readme,
    rviz_text,
)
from thorvaldc.backends.ros2_parameter_file import parameter_file
from thorvaldc.backends.ros2_parameters import (
    Parameters,
    base_driver,
    game_controller,
    robot_state_publisher,
    teleop,
)
from thorvaldc.backends.ros2_parts import Parts, node_space, parts_of
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import to_json
from thorvaldc.model.settings import package_name

FOLDER = "ros2"


class Ros2(Backend):
    name = "ros2"
    summary = "ROS 2 package: description, parameters, launch files, base driver (ros2/)"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        return {f"{FOLDER}/{path}": data for path, data in package_of(robot).items()}

    def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
        """Return the package of each robot, and a package that starts all robots."""
        files = fleet_package(fleet)
        return {
            **super().emit_fleet(fleet),
            **{f"{FOLDER}/{path}": data for path, data in files.items()},
        }


def fleet_package(fleet: Fleet) -> dict[str, bytes]:
    """Return the files of the ROS 2 package that starts all robots of a fleet, by their path in
    the package."""
    members = [placement.robot.ros.package for placement in fleet.placements]
    package = package_name(f"{fleet.name}_fleet")
    while package in members:
        package += "_all"
    launch = fleet_launch_file(fleet)
    files = {
        "README.md": fleet_readme(fleet, package).encode(),
        "launch/fleet.launch.py": launch.encode(),
    }
    description = f"The fleet {fleet.name}, made by thorvaldc"
    return {**package_files(package, description, files, [launch], members), **files}


def package_of(robot: Robot) -> dict[str, bytes]:
    """Return the files of the ROS 2 package of a robot, by their path in the package."""
    parts = parts_of(robot)
    launches = launch_files(robot, parts)
    names = [posixpath.basename(path).removesuffix(".launch.py") for path in launches]
    plugins = set(plugin_packages(robot, parts))
    if any(frame.kind == "relay" for bus in robot.buses for frame in bus.frames):
        plugins.add("can_msgs")  # the base driver relays frames of foreign devices
    control: dict[str, bytes] = {}
    if robot.actuators:
        control = {**control_files(robot), **ros2_control_files(robot)}
        plugins |= control_packages(robot)
        left_out = (*parts.left_out, *left_out_of_control(robot))
        parts = parts._replace(left_out=left_out)
    files = {
        **driver_module(robot),
        "README.md": readme(robot, parts, names).encode(),
        "config/model.json": to_json(robot).encode(),
        "urdf/robot.urdf": urdf_text(robot, f"package://{robot.ros.package}/meshes").encode(),
        **{f"meshes/{mesh.name}": mesh.data for mesh in robot.meshes},
        "rviz/robot.rviz": rviz_text(robot, parts).encode(),
        **{path: text.encode() for path, text in launches.items()},
        **_parameter_files(robot, parts),
        **control,
    }
    description = f"The robot {robot.name}, made by thorvaldc"
    return {
        **package_files(robot.ros.package, description, files, launches.values(), plugins),
        **files,
    }


def _parameter_files(robot: Robot, parts: Parts) -> dict[str, bytes]:
    files: dict[str, dict[str, Parameters]] = {
        "base_driver": {"base_driver": base_driver(robot, parts)},
        "robot_state_publisher": {"robot_state_publisher": robot_state_publisher(robot)},
        "teleop_twist_joy": {
            "game_controller_node": game_controller(robot),
            "teleop_twist_joy_node": teleop(robot, robot.ros.stamped),
        },
    }
    if parts.local_ekf:
        files["ekf_odom"] = {"ekf_odom": ekf_odom(robot, parts)}
    if parts.gnss is not None:
        files["gnss"] = {
            "ekf_map": ekf_map(robot, parts),
            "navsat_transform": navsat_transform(robot, parts),
        }
    if parts.slam is not None:
        files["slam_toolbox"] = {"slam_toolbox": slam_toolbox(robot, parts.slam)}
    if parts.navigation:
        files["nav2"] = nav2(robot, parts)
        for source in parts.map_sources or ("none",):
            files[f"global_costmap_{source}"] = {
                "global_costmap/global_costmap": global_costmap(robot, parts, source)
            }
    space = node_space(robot)
    return {
        f"config/{file}.yaml": parameter_file(
            {space + node: values for node, values in nodes.items()}
        ).encode()
        for file, nodes in files.items()
    }
