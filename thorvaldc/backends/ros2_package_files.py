"""The files of a ROS 2 package around its parameters: README, RViz configuration, package.xml,
setup.py, launch files and the program of the base driver, from the templates in ``templates/ros2``.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple

from thorvaldc.backends import ros2_parts
from thorvaldc.backends.ros2_controllers import controllers, twist_controller
from thorvaldc.backends.ros2_navigation import Motion
from thorvaldc.backends.ros2_parameters import quoted
from thorvaldc.backends.ros2_sensors import sensor_nodes
from thorvaldc.backends.templates import Templates
from thorvaldc.backends.xml_writer import escape
from thorvaldc.model import Fleet, Robot, Sensor
from thorvaldc.model.settings import ANY_FIRST, EKF, RAMP_FIRST, ZERO_FIRST, RosSettings

_NEEDED = re.compile(
    r"""\b(?:package|pkg)=["']([a-z0-9_]+)["']|\bpkg: *["']?([a-z0-9_]+)"""
    r"""|\b(?:get_package_share_directory|FindPackageShare)\(["']([a-z0-9_]+)["']\)"""
    r"""|find-pkg-share ([a-z0-9_]+)|\bnode\("([a-z0-9_]+)", \""""
)
"""ROS packages that a launch file names, in Python, XML or YAML."""
_NOBODY = "unknown <unknown@example.org>"
_RUNTIME = ("ament_index_python", "launch", "launch_ros", "rclpy")
_MESSAGES = ("builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces")
_MORE_MESSAGES = ("rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs")
_TEMPLATES = Templates("ros2", {"quoted": quoted, "xml": escape})

LAUNCHES = {
    "ideal": "simulation with ideal joints",
    "mujoco": "simulation in MuJoCo, with `/clock`",
    "virtual": "the driver on a simulated bus",
    "robot": "the real robot; `bus:=socketcan:can0`",
    "sensors": "part of `robot`: the drivers of its sensors",
    "teleop": "a pad moves the robot",
    "gazebo": "simulation in Gazebo",
    "ros2_control": "joints of ros2_control; `hardware:=mock`",
    "joint_states": "the robot in Isaac Sim, by messages JointState",
    "gnss": "GNSS, odometry and IMU give the pose in `map`",
    "slam": "slam_toolbox makes a map",
    "amcl": "AMCL gives the pose in a saved map; `map:=field.yaml`",
    "navigation": "Nav2 with its localization, beside a launch file that starts the robot",
    "base": "part of others: description and base driver",
}
"""Content of each launch file, for the README."""
BEGINNINGS = {
    ZERO_FIRST: "begins with zero",
    RAMP_FIRST: "begins with zero, or after a silence with the first step of a ramp, as Nav2 does",
    ANY_FIRST: "begins with any twist, and resumes",
}
"""What a source of twists begins with, for the README."""
_LAUNCH_TEMPLATES = Templates("ros2/launch")
_SIM_TIME = {"use_sim_time": "true"}
_CLOCK = {**_SIM_TIME, "publish_clock": "true"}
# The launch files that include ``base.launch.py``: what they start, and their arguments.
_BASES = {
    "ideal": ("Simulation with ideal joints, without physics.", {"base": "ideal"}),
    "mujoco": (
        "Simulation in MuJoCo, which gives the time of all nodes by /clock.",
        {"base": "mujoco", **_CLOCK},
    ),
    "virtual": ("The real driver on a simulated bus with simulated drives.", {"base": "virtual"}),
    "robot": ("The real robot on its CAN bus.", {"base": "bus"}),
    "joint_states": (
        "The robot in Isaac Sim, or in another program that takes and sends JointState messages.",
        {"base": "topics", "joint_topics": "joint_states", "guard": "true", **_SIM_TIME},
    ),
}


class Display(NamedTuple):
    """A display of RViz. ``kind`` is the last part of its class, such as ``LaserScan``."""

    name: str
    kind: str
    topic: str = ""
    is_latched: bool = False
    is_best_effort: bool = False


def package_files(
    package: str,
    title: str,
    settings: RosSettings,
    files: Mapping[str, bytes],
    launch_texts: Iterable[str],
    plugins: Iterable[str] = (),
    description: str = "",
) -> dict[str, bytes]:
    """Return the files of a folder and those that make it an ament_python package, by path.

    - ``title``: one line, the description of a package without ``description``.
    - ``settings``: licence, maintainer and version of the package.
    - ``files``: the other files of the package. Their folders are installed.
    - ``launch_texts``: text of the launch files. The package depends on the ROS packages that the
      launch files name.
    - ``plugins``: ROS packages that the launch files do not name by themselves.
    """
    depends = set(_RUNTIME) | set(plugins)
    for text in launch_texts:
        for groups in _NEEDED.findall(text):
            depends.add(next(name for name in groups if name))
    has_driver = f"{package}/base_driver.py" in files
    if has_driver:
        depends.update(_MESSAGES, _MORE_MESSAGES, ["python3-venv"])  # README: the environment
    depends.discard(package)
    values = {
        "package": package,
        "title": title,
        "description": description or title,
        "settings": settings,
        "maintainer": (settings.maintainer or _NOBODY).removesuffix(">").split(" <"),
        "depends": sorted(depends),
        "has_driver": has_driver,
        "folders": sorted({posixpath.dirname(path) for path in files} - {"", package}),
    }
    paths = ("package.xml", "setup.py", "setup.cfg", "test/test_package.py")
    texts = {path: _TEMPLATES.render(posixpath.basename(path), **values) for path in paths}
    manifest = {path: text.encode() for path, text in texts.items()}
    all_files = {**manifest, f"resource/{package}": b"", **files}
    header = _license_header(settings).encode()
    return {
        path: header + data if path.endswith(".py") and data else data
        for path, data in all_files.items()
    }


def _license_header(settings: RosSettings) -> str:
    """Return the comment of each Python file, without a year: a build contains no date."""
    if not settings.license:
        return ""
    owner = settings.maintainer.partition(" <")[0]
    holder = f"# Copyright (c) {owner}\n" if owner else ""
    return f"{holder}# SPDX-License-Identifier: {settings.license}\n\n"


def driver_module(robot: Robot) -> dict[str, bytes]:
    """Return the Python package with the program of the base driver, by path."""
    package = robot.ros.package
    program = _TEMPLATES.render("base_driver.py", package=package)
    return {f"{package}/__init__.py": b"", f"{package}/base_driver.py": program.encode()}


def readme(robot: Robot, parts: ros2_parts.Parts, launches: Iterable[str]) -> str:
    """Return the README: commands, parts, and what is left out with the reasons.

    ``launches`` lists the names of the launch files.
    """
    sensors = [
        {
            "name": sensor.name,
            "topic": ros2_parts.sensor_topic(robot, sensor),
            "type": ros2_parts.SENSOR_TOPICS[sensor.type][0][1],
            "frame": f"{robot.prefix}{sensor.link}",
        }
        for sensor in robot.sensors
        if sensor.type in ros2_parts.SENSOR_TOPICS and sensor.type != "camera"
    ]
    return _TEMPLATES.render(
        "README.md",
        robot=robot,
        package=robot.ros.package,
        topic=partial(ros2_parts.full_topic, robot),
        sensors=sensors,
        launches={name: LAUNCHES[name] for name in launches},
        own=[own.name for own in robot.ros.launch],
        left_out=parts.left_out,
        beginnings=BEGINNINGS,
    )


def own_launch_files(robot: Robot) -> dict[str, bytes]:
    """Return the launch files of the robot file by their path in the package."""
    return {f"launch/{own.name}": own.text.encode() for own in robot.ros.launch}


def fleet_readme(fleet: Fleet, package: str) -> str:
    """Return the README of the package that starts all robots of a fleet."""
    return _TEMPLATES.render("fleet_README.md", fleet=fleet, package=package)


def rviz_text(robot: Robot, parts: ros2_parts.Parts) -> str:
    """Return the text of the RViz configuration: the robot, its odometry, its lidars and the map.

    Everything is shown in the frame ``odom``, which exists without localization too.
    """
    topic = partial(ros2_parts.full_topic, robot)
    displays = [
        Display("Grid", "Grid"),
        Display("Robot", "RobotModel", topic("robot_description"), is_latched=True),
        Display("Frames", "TF"),
        Display("Odometry", "Odometry", topic("odometry/base_raw")),
    ]
    kinds = {"lidar_2d": "LaserScan", "lidar_3d": "PointCloud2"}
    for lidar in parts.lidars:
        kind, scan = kinds[lidar.type], ros2_parts.sensor_topic(robot, lidar)
        displays.append(Display(lidar.name, kind, scan, is_best_effort=True))
    if parts.navigation:
        costmap = topic("local_costmap/costmap")
        displays.append(Display("Local costmap", "Map", costmap, is_latched=True))
        displays.append(Display("Path", "Path", topic("plan")))
    if parts.slam is not None:
        displays.append(Display("Map", "Map", topic("map"), is_latched=True))
    return _TEMPLATES.render(
        "robot.rviz",
        displays=displays,
        fixed_frame=ros2_parts.odom_frame(robot),
        goal_topic=topic("goal_pose"),
        initial_topic=topic("initialpose"),
        has_map=parts.slam is not None,
    )


# -- launch files --------------------------------------------------------------------------
#
# ``base.launch.py`` starts the robot's description and its base driver; the launch files of
# simulations and of the real robot include it with other arguments. The launch files contain the
# names of the package, of its name space and of topics; the parameter files have all other values.


def fleet_launch_file(fleet: Fleet, package: str) -> str:
    """Return the text of the launch file that starts all robots of a fleet at their places.

    ``package``: the package of the launch file, with the world of Gazebo.  With MuJoCo, each base
    driver has its own world, and the simulations go on by the time of that with most control
    cycles.
    """
    robots = []
    for placement in fleet.placements:
        robot, pose = placement.robot, placement.pose
        w, *xyz = pose.quat
        place = [*pose.xyz, *xyz, w]
        robots.append((robot.ros.package, robot.namespace, place, list(pose.clean().rpy())))
    rates = [placement.robot.driver.rate for placement in fleet.placements]
    clock = rates.index(max(rates))
    values = {"package": package, "fleet": fleet.name, "robots": robots, "clock": clock}
    return _LAUNCH_TEMPLATES.render("fleet.launch.py", **values)


def launch_files(robot: Robot, parts: ros2_parts.Parts) -> dict[str, str]:
    """Return the launch files of a robot by their path in the package."""
    names = ["base", "ideal", "mujoco", "teleop"]
    if robot.buses:
        names += ["virtual", "robot"]
    if any(sensor.ros2_driver is not None for sensor in robot.sensors):
        names.append("sensors")
    if parts.gnss is not None:
        names.append("gnss")
    if parts.slam is not None:
        names += ["slam", "amcl"]
    if parts.navigation:
        names.append("navigation")
    if robot.actuators:
        names += ["gazebo", "ros2_control", "joint_states"]
    values = _values(robot, parts)
    texts = {}
    for name in names:
        summary, arguments = _BASES.get(name, ("", {}))
        values["is_real"] = name == "robot"
        values["own"] = [own.name for own in robot.ros.launch] if name == "robot" else []
        template = "include_base" if name in _BASES else name
        texts[f"launch/{name}.launch.py"] = _LAUNCH_TEMPLATES.render(
            f"{template}.launch.py", summary=summary, arguments=arguments, **values
        )
    return texts


def _values(robot: Robot, parts: ros2_parts.Parts) -> dict[str, Any]:
    """Return the values that the templates of a robot name."""
    controller = twist_controller(robot)
    return {
        "package": robot.ros.package,
        "namespace": robot.namespace,
        "robot_name": robot.name,
        "bus": ",".join(f"{bus.name}=socketcan:can{i}" for i, bus in enumerate(robot.buses))
        if len(robot.buses) > 1
        else "socketcan:can0",
        "odom_tf": "false" if robot.ros.odom_tf == EKF else "true",
        "stamped": str(robot.ros.stamped).lower(),
        "teleop_topic": ros2_parts.source_topic(robot, "teleop_joy"),
        "local_ekf": parts.local_ekf,
        "gnss_topic": _topic_of(parts.gnss),
        "imu_topic": _topic_of(parts.imu),
        "map_sources": parts.map_sources,
        "localizations": parts.map_sources or ("none",),
        "turns_on_the_spot": Motion(robot).kind != "ackermann",
        "controllers": [c.name for c in controllers(robot) if c.is_released],
        "command_topic": controller.command_topic if controller is not None else "",
        "odometry_topic": controller.odometry_topic if controller is not None else "",
        "gazebo_clock": ros2_parts.GAZEBO_CLOCK,
        "sensor_nodes": list(sensor_nodes(robot)),
    }


def _topic_of(sensor: Sensor | None) -> str:
    """Return the first topic of a sensor, relative to the name space."""
    return ros2_parts.sensor_topics(sensor)[0][0] if sensor is not None else ""
