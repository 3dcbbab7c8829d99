"""Builds ROS 2 packages of examples in a folder, as if colcon had installed them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from tests.backends.rcl_parameters import read
from tests.backends.ros2.launch_double import Context, run
from tests.examples import example_robot
from thorvaldc.backends.ros2 import Ros2
from thorvaldc.backends.ros2 import package_of as new_package_of
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.settings import NAME_PREFIX, NAME_SPACE

# Stands for the launch file of ros_gz_sim, with one of its arguments.
GZ_SIM = b"""\
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
def generate_launch_description():
    return LaunchDescription(
        [DeclareLaunchArgument("gz_args", default_value="", description="options of gz sim")]
    )
"""
DISTROS = ("jazzy", "kilted", "lyrical")
package_of = once_per_model(new_package_of)


def variant(name: str, **settings: str) -> Robot:
    """Return an example with other settings of its section `ros`, and its name space."""
    robot = example_robot(name)
    namespace = settings.pop("namespace", robot.namespace)
    ros = dataclasses.replace(robot.ros, **settings)
    return dataclasses.replace(robot, namespace=namespace, ros=ros)


def braking_gently(robot: Robot) -> Robot:
    """Return the robot with decelerations that differ from its accelerations."""
    limits = {
        "max_linear_acceleration": 1.2,
        "max_linear_deceleration": 0.25,
        "max_angular_acceleration": 1.6,
        "max_angular_deceleration": 0.9,
    }
    return dataclasses.replace(robot, driver=dataclasses.replace(robot.driver, **limits))


def write(folder: Path, files: dict[str, bytes]) -> Path:
    for path, data in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    return folder


def install(robot: Robot, folder: Path) -> dict[str, Path]:
    """Write the package of a robot; return the shared folder by the name of the package."""
    return {robot.ros.package: write(folder / robot.ros.package, package_of(robot))}


def install_fleet(fleet: Fleet, folder: Path) -> dict[str, Path]:
    write(folder, Ros2().emit_fleet(fleet))
    shares = {p.robot.ros.package: folder / p.name / "ros2" for p in fleet.placements}
    return {**shares, f"{fleet.name}_fleet": folder / "ros2"}


def named(robot: Robot, path: str) -> str:
    """Return a file of the package of a robot with the names that its launch files put in."""
    text = package_of(robot)[path].decode()
    return text.replace(NAME_PREFIX, robot.prefix).replace(NAME_SPACE, f"/{robot.namespace}")


def parameter_files(robot: Robot) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the parameters of each node, as rcl reads them, by the name of the file."""
    return {
        Path(path).stem: read(named(robot, path))
        for path in package_of(robot)
        if path.startswith("config/") and path.endswith(".yaml") and "gz_bridge" not in path
    }


def parameters(robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in all files.

    The global costmap has a file for each localization; the first one counts.
    """
    nodes: dict[str, dict[str, Any]] = {}
    for file, content in parameter_files(robot).items():
        for node, values in content.items():
            assert node not in nodes or file.startswith("global_costmap"), f"{node} is in two files"
            nodes.setdefault(node, values)
    return nodes


_WRITTEN: dict[Path, list[Robot]] = {}


def launch(robot: Robot, folder: Path, file: str, **arguments: str) -> Context:
    """Execute a launch file of the package of a robot, which is written if it is not there."""
    shares = {robot.ros.package: folder / robot.ros.package}
    if robot not in _WRITTEN.get(folder, ()):
        shares = install(robot, folder)
        _WRITTEN[folder] = [robot]
    # Nav2 and ros_gz_sim are not installed where the tests run.
    shares["nav2_bt_navigator"] = folder / "nav2_bt_navigator"
    shares["ros_gz_sim"] = write(folder / "ros_gz_sim", {"launch/gz_sim.launch.py": GZ_SIM})
    if file == "amcl" or arguments.get("localization") == "amcl":
        saved_map = write(shares[robot.ros.package], {"field.yaml": b"image: field.pgm\n"})
        arguments = {"map": str(saved_map / "field.yaml"), **arguments}
    path = shares[robot.ros.package] / "launch" / f"{file}.launch.py"
    return run(path, shares, **arguments)
