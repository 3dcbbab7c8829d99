"""Simulation in Gazebo, which gives the time of all nodes."""

import json
import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    AppendEnvironmentVariable,
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = ""
PLACE = ("x", "y", "z", "R", "P", "Y")


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "gz_args", default_value="-r", description="options of gz sim; -r -s: no window"
            ),
            DeclareLaunchArgument(
                "world",
                default_value=os.path.join(
                    get_package_share_directory(PACKAGE), "sdf", "world.sdf"
                ),
                description="world of Gazebo; empty: Gazebo runs already, with the time on /clock",
            ),
            *[
                DeclareLaunchArgument(
                    name, default_value="0.0", description="place in the world, in m and rad"
                )
                for name in PLACE
            ],
            DeclareLaunchArgument(
                "model",
                default_value="",
                description="ros2/config/model.json of another build, which drives in place of"
                " this one",
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
            OpaqueFunction(function=start),
        ]
    )


def start(context):
    share = get_package_share_directory(PACKAGE)
    package, namespace, robot_name = PACKAGE, NAMESPACE, "thorvald_4wd4ws_wide"
    other = LaunchConfiguration("model").perform(context)
    if other:
        share = folder_of(other)
        with open(other, encoding="utf-8") as file:
            robot = json.load(file)["model"]
        package, namespace = robot["ros"]["package"], robot["namespace"]
        robot_name = namespace or robot["name"]
    config = os.path.join(share, "config")
    variant, moved_by = "", base_driver
    with open(os.path.join(share, "sdf", f"model{variant}.sdf"), encoding="utf-8") as file:
        model = file.read().replace(f"$(find {package})", share)
    if other:
        model = model.replace(f"model://{package}/", f"file://{share}/")
    place = [text for name in PLACE for text in (f"-{name}", LaunchConfiguration(name))]
    return [
        # Gazebo finds the meshes of the package in this folder.
        AppendEnvironmentVariable("GZ_SIM_RESOURCE_PATH", os.path.dirname(share)),
        *gazebo(LaunchConfiguration("world").perform(context), config),
        Node(
            package="ros_gz_sim",
            executable="create",
            name="create",
            namespace=namespace,
            output="screen",
            arguments=["-name", robot_name, "-string", model, *place],
        ),
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            name="gz_bridge",
            namespace=namespace,
            output="screen",
            parameters=[
                {"config_file": os.path.join(config, f"gz_bridge{variant}.yaml")},
                {"use_sim_time": True},
            ],
        ),
        *moved_by(),
    ]


def gazebo(world, config):
    if not world:
        return []
    launch = os.path.join(get_package_share_directory("ros_gz_sim"), "launch", "gz_sim.launch.py")
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(launch),
            launch_arguments={"gz_args": [LaunchConfiguration("gz_args"), " ", world]}.items(),
        ),
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            name="gz_bridge_clock",
            namespace=NAMESPACE,
            output="screen",
            parameters=[{"config_file": os.path.join(config, "gz_bridge_clock.yaml")}],
        ),
        # Gazebo sends the time at every step of the physics; the nodes get every 10th.
        Node(
            package="topic_tools",
            executable="drop",
            name="clock_drop",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                {
                    "input_topic": "gazebo_clock",
                    "output_topic": "/clock",
                    "X": 9,
                    "Y": 10,
                }
            ],
        ),
    ]


def base_driver():
    share = get_package_share_directory(PACKAGE)
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(share, "launch", "base.launch.py")),
            launch_arguments={
                "base": "topics",
                "joint_topics": "gazebo",
                "guard": "true",
                "use_sim_time": "true",
                "model": LaunchConfiguration("model"),
                "rviz": LaunchConfiguration("rviz"),
            }.items(),
        )
    ]


def folder_of(model):
    share = os.path.dirname(os.path.dirname(os.path.abspath(model)))
    if not os.path.isfile(os.path.join(share, "config", "base_driver.yaml")):
        raise RuntimeError(f"model is {model}; expected ros2/config/model.json of a build")
    return share
