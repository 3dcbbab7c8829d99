"""The target `ros2`: an ament_python package that starts the robot in ROS 2.

The folder ``ros2/`` of a build is the package. The page docs/ros2.md describes it. Its parts are in
the modules whose names begin with ``ros2_``, and the texts that are not parameters in the folder
``templates/ros2``.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterable, Mapping
from dataclasses import replace

from thorvaldc.backends import (
    Backend,
    ros2_navigation,
    ros2_package_files,
    ros2_parameters,
    ros2_parts,
)
from thorvaldc.backends import ros2_controllers as controllers
from thorvaldc.backends.mjcf import ros2_control_files
from thorvaldc.backends.ros2_control import hardware_problem
from thorvaldc.backends.ros2_parameters import HEADER, Parameters, parameter_file, quoted
from thorvaldc.backends.ros2_sensors import sensor_nodes
from thorvaldc.backends.sdf import model_text, world_files
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import to_json
from thorvaldc.model.settings import NAME_PREFIX, NAME_SPACE, package_name

FOLDER = "ros2"
_SPACE = "thorvaldc_name_space"
"""Name space of the robot in the files that `in_any_name_space` changes."""


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
    launch = ros2_package_files.fleet_launch_file(fleet, package)
    robots = [placement.robot for placement in fleet.placements]
    poses = [placement.pose for placement in fleet.placements]
    files = {
        "README.md": ros2_package_files.fleet_readme(fleet, package).encode(),
        "launch/fleet.launch.py": launch.encode(),
        **world_files(fleet.name, robots, fleet.world, poses),
    }
    title = f"The fleet {fleet.name}, made by thorvaldc"
    settings = robots[0].ros
    return ros2_package_files.package_files(package, title, settings, files, [launch], members)


def package_of(robot: Robot) -> dict[str, bytes]:
    """Return the files of the ROS 2 package of a robot, by their path in the package."""
    parts, named = ros2_parts.parts_of(robot), replace(robot, namespace=_SPACE)
    launches = ros2_package_files.launch_files(robot, parts)
    names = [posixpath.basename(path).removesuffix(".launch.py") for path in launches]
    plugins = set(ros2_navigation.plugin_packages(robot, parts))
    if any(frame.kind == "relay" for bus in robot.buses for frame in bus.frames):
        plugins.add("can_msgs")  # the base driver relays frames of foreign devices
    if robot.buses:
        plugins.add("control_msgs")  # the base driver publishes what the devices report
    control: dict[str, str] = {}
    worlds: dict[str, bytes] = {}
    if robot.actuators:
        scene = {path: data.decode() for path, data in ros2_control_files(named).items()}
        control = {**control_files(named), **scene}
        worlds = world_files(robot.name, [robot])
        plugins |= controllers.control_packages(robot)
        left_out = (*parts.left_out, *left_out_of_control(robot))
        parts = parts._replace(left_out=left_out)
    files = {
        **ros2_package_files.driver_module(robot),
        "README.md": ros2_package_files.readme(robot, parts, names).encode(),
        "config/model.json": to_json(robot).encode(),
        **in_any_name_space(
            robot,
            {
                "urdf/robot.urdf": urdf_text(named, f"package://{robot.ros.package}/meshes"),
                "rviz/robot.rviz": ros2_package_files.rviz_text(named, parts),
                **_parameter_files(named, parts),
                **control,
            },
        ),
        **worlds,
        **{f"meshes/{mesh.name}": mesh.data for mesh in robot.meshes},
        **{path: text.encode() for path, text in launches.items()},
    }
    title = f"The robot {robot.name}, made by thorvaldc"
    own = ros2_package_files.own_launch_files(robot)
    plugins |= {f"launch_{kind}" for kind in ("xml", "yaml") for path in own if path.endswith(kind)}
    texts = [*launches.values(), *(launch.text for launch in robot.ros.launch)]
    package = ros2_package_files.package_files(
        robot.ros.package, title, robot.ros, files, texts, plugins, robot.description
    )
    return {**package, **own}


def in_any_name_space(robot: Robot, files: Mapping[str, str]) -> dict[str, bytes]:
    """Return the files of a robot in the name space ``_SPACE`` with places for its names.

    The launch files put names in: launch itself in parameter files, where a backslash begins an
    escape sequence of it, and they in the other files.
    """
    named = {}
    for path, text in files.items():
        if path.startswith("config/"):
            text = text.replace("\\", "\\\\").replace("$(", "\\$(")
        text = text.replace(f"{_SPACE}/", NAME_PREFIX)
        text = text.replace(f'"{_SPACE}"', f'"{robot.name}"').replace(f"/{_SPACE}", NAME_SPACE)
        named[path] = text.encode()
    return named


def _parameter_files(robot: Robot, parts: ros2_parts.Parts) -> dict[str, str]:
    files: dict[str, dict[str, Parameters]] = {
        "base_driver": {"base_driver": ros2_parameters.base_driver(robot, parts)},
        "robot_state_publisher": {
            "robot_state_publisher": ros2_parameters.robot_state_publisher(robot)
        },
        "diagnostics": {"analyzers": ros2_parameters.aggregator(robot)},
        "teleop_twist_joy": {
            "game_controller_node": ros2_parameters.game_controller(robot),
            "teleop_twist_joy_node": ros2_parameters.teleop(robot, robot.ros.stamped),
        },
    }
    if parts.local_ekf:
        files["ekf_odom"] = {"ekf_odom": ros2_parameters.ekf_odom(robot, parts)}
    if parts.gnss is not None:
        files["gnss"] = {
            "ekf_map": ros2_parameters.ekf_map(robot, parts),
            "navsat_transform": ros2_parameters.navsat_transform(robot, parts),
        }
    if parts.slam is not None:
        files["slam_toolbox"] = {"slam_toolbox": ros2_parameters.slam_toolbox(robot, parts.slam)}
        files["amcl"] = ros2_navigation.amcl(robot, parts.slam)
    if parts.navigation:
        files["nav2"] = ros2_navigation.nav2(robot, parts)
        for source in parts.map_sources or ("none",):
            files[f"global_costmap_{source}"] = {
                "global_costmap/global_costmap": ros2_navigation.global_costmap(
                    robot, parts, source
                )
            }
    drivers = {node.full_name: node.parameters for node in sensor_nodes(robot)}
    if drivers:
        files["sensors"] = drivers
    space = ros2_parts.node_space(robot)
    comments = {"base_driver": ros2_parameters.FILTER_NOISE} if parts.localization else {}
    comments["gnss"] = ros2_parameters.HEADING
    return {
        f"config/{file}.yaml": parameter_file(
            {space + node: values for node, values in nodes.items()}, comments.get(file, "")
        )
        for file, nodes in files.items()
    }


# -- controllers of ros2_control or of Gazebo ----------------------------------------------


def left_out_of_control(robot: Robot) -> list[tuple[str, str]]:
    """Return what ros2_control cannot do with the robot, and the reasons."""
    problem = hardware_problem(robot, "can")
    files = "the tool dcfgen of ros2_canopen makes the files of the master from can/bus.yml"
    return [("ros2_control on the CAN bus", problem or files)]


def control_files(robot: Robot) -> dict[str, str]:
    """Return the parameters, descriptions and models of ros2_control and Gazebo, by path.

    In Gazebo the base driver moves every robot by a topic of each joint; the files with
    ``ros2_control`` in their names are those for a robot that its standard controllers can move.
    """
    package = robot.ros.package
    meshes, share = f"package://{package}/meshes", f"$(find {package})"
    is_driven = controllers.twist_controller(robot) is not None
    kinds = ["mock", "mujoco", *(["gazebo"] if is_driven else [])]
    files = {f"urdf/robot_{kind}.urdf": urdf_text(robot, meshes, kind, share) for kind in kinds}
    files["sdf/model.sdf"] = model_text(robot, f"model://{package}/meshes")
    files["config/gz_bridge.yaml"] = gz_bridge(ros2_parts.bridged_topics(robot))
    files["config/gz_bridge_clock.yaml"] = gz_bridge([ros2_parts.CLOCK_TOPIC])
    files[controllers.CONTROLLER_FILE] = parameter_file(
        controllers.controller_parameters(robot)[controllers.CONTROLLER_FILE]
    )
    if is_driven:
        topics = ros2_parts.bridged_topics(robot, ros2_control=True)
        files["sdf/model_ros2_control.sdf"] = model_text(robot, f"model://{package}/meshes", share)
        files["config/gz_bridge_ros2_control.yaml"] = gz_bridge(topics)
        mux = {f"{ros2_parts.node_space(robot)}twist_mux": ros2_parameters.twist_mux(robot)}
        files["config/twist_mux.yaml"] = parameter_file(mux)
    return files


def gz_bridge(topics: Iterable[ros2_parts.BridgedTopic]) -> str:
    """Return the text of the YAML file ``config_file`` of the node ros_gz_bridge."""
    entries = [
        f"- ros_topic_name: {quoted(topic.ros)}\n"
        f"  gz_topic_name: {quoted(topic.gazebo)}\n"
        f"  ros_type_name: {quoted(topic.ros_type)}\n"
        f"  gz_type_name: {quoted(topic.gazebo_type)}\n"
        f"  direction: {'ROS_TO_GZ' if topic.to_gazebo else 'GZ_TO_ROS'}\n"
        for topic in topics
    ]
    return "".join([HEADER, *entries])
