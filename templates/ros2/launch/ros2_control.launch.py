"""Joints of ros2_control, which its controllers move, or the base driver through them."""

import atexit
import os
import re
import shutil
import tempfile

from launch import LaunchDescription
from launch.actions import (
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
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = LaunchConfiguration("namespace")
CONTROLLERS = [
    # % for name in controllers
    "{{ name }}",
    # % endfor
]
MANAGER = ["/", LaunchConfiguration("name_prefix"), "controller_manager"]


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
        DeclareLaunchArgument(
            "hardware",
            default_value="mock",
            choices=["mock", "mujoco"],
            description="ideal joints, or joints in MuJoCo by mujoco_ros2_control",
        ),
        OpaqueFunction(function=start),
    )


def start(context):
    """Return the nodes."""
    hardware = LaunchConfiguration("hardware").perform(context)
    has_clock = hardware == "mujoco"
    use_sim_time = {"use_sim_time": has_clock}
    package = "mujoco_ros2_control" if has_clock else "controller_manager"
    return [
        Node(
            package=package,
            executable="ros2_control_node",
            name="controller_manager",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("controllers"), use_sim_time],
            # % if odometry_topic
            remappings=[("{{ odometry_topic }}", "odometry/base_raw")],
            # % endif
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            name="spawner",
            namespace=NAMESPACE,
            output="screen",
            arguments=[*CONTROLLERS, "--controller-manager", MANAGER],
        ),
        # % if command_topic
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("robot_state_publisher"),
                description_of(context, f"robot_{hardware}.urdf"),
                use_sim_time,
            ],
        ),
        Node(
            package="twist_mux",
            executable="twist_mux",
            name="twist_mux",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("twist_mux"), use_sim_time],
            remappings=[("cmd_vel_out", "{{ command_topic }}")],
        ),
        # % else
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(SHARE, "launch", "base.launch.py")),
            launch_arguments={
                "base": "topics",
                "joint_topics": "ros2_control",
                "guard": "true",
                "use_sim_time": str(has_clock).lower(),
                "urdf": f"robot_{hardware}.urdf",
            }.items(),
        ),
        # % endif
    ]


# % include "named_files.py"
# % include "other_build.py"
