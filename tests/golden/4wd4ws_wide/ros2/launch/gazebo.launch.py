"""Simulation in Gazebo, which gives the time of all nodes."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    AppendEnvironmentVariable,
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    SetLaunchConfiguration,
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = ""
PLACE = ("x", "y", "z", "R", "P", "Y")


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
        DeclareLaunchArgument(
            "gz_args", default_value="-r", description="options of gz sim; -r -s: no window"
        ),
        DeclareLaunchArgument(
            "world",
            default_value=os.path.join(SHARE, "sdf", "world.sdf"),
            description="world of Gazebo; empty: Gazebo runs already, with the time on /clock",
        ),
        *[
            DeclareLaunchArgument(
                name, default_value="0.0", description="place in the world, in m and rad"
            )
            for name in PLACE
        ],
        DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
        OpaqueFunction(function=start),
    )


def start(context):
    """Return Gazebo with the robot in it."""
    config = os.path.join(SHARE, "config")
    variant, moved_by = "", base_driver
    with open(os.path.join(SHARE, "sdf", f"model{variant}.sdf"), encoding="utf-8") as file:
        model = file.read().replace("$(find thorvald_4wd4ws_wide)", SHARE)
    if LaunchConfiguration("driver_package", default="").perform(context):
        model = model.replace("model://thorvald_4wd4ws_wide/", f"file://{SHARE}/")
    place = [text for name in PLACE for text in (f"-{name}", LaunchConfiguration(name))]
    return [
        # Gazebo finds the meshes of the package in this folder.
        AppendEnvironmentVariable("GZ_SIM_RESOURCE_PATH", os.path.dirname(SHARE)),
        *gazebo(LaunchConfiguration("world").perform(context), config),
        Node(
            package="ros_gz_sim",
            executable="create",
            name="create",
            namespace=NAMESPACE,
            output="screen",
            arguments=["-name", "thorvald_4wd4ws_wide", "-string", model, *place],
        ),
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            name="gz_bridge",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                {"config_file": os.path.join(config, f"gz_bridge{variant}.yaml")},
                {"use_sim_time": True},
            ],
        ),
        *moved_by(),
    ]


def gazebo(world, config):
    """Return Gazebo with its time on /clock, or nothing if it runs already."""
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
    """Return the nodes that move the robot by the base driver."""
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(SHARE, "launch", "base.launch.py")),
            launch_arguments={
                "base": "topics",
                "joint_topics": "gazebo",
                "guard": "true",
                "use_sim_time": "true",
                "rviz": LaunchConfiguration("rviz"),
            }.items(),
        )
    ]


SHARE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def launch_description(*entities):
    """Return these entities, or the same launch file of the build that `model` names."""
    model = LaunchConfiguration("model")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "model",
                default_value="",
                description="ros2/config/model.json of another build, which is started in place of"
                " this one",
            ),
            GroupAction(
                list(entities), scoped=False, condition=IfCondition(EqualsSubstitution(model, ""))
            ),
            OpaqueFunction(function=other_build),
        ]
    )


def other_build(context):
    """Include the launch file of the other build; it starts the base driver of this package."""
    model = LaunchConfiguration("model").perform(context)
    if not model:
        return []
    share = os.path.dirname(os.path.dirname(os.path.abspath(model)))
    launch = os.path.join(share, "launch", os.path.basename(__file__))
    if not os.path.isfile(launch):
        raise RuntimeError(
            f"model is {model}; expected ros2/config/model.json of a build that has the launch"
            f" file {os.path.basename(__file__)}"
        )
    # The group keeps the settings from what is started later.
    return [
        GroupAction(
            [
                SetLaunchConfiguration("driver_package", PACKAGE),
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(launch), launch_arguments={"model": ""}.items()
                ),
            ]
        )
    ]
