"""Joints of ros2_control, which its controllers move, or the base driver through them."""

import os

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
# % if command_topic
from launch_ros.parameter_descriptions import ParameterValue
# % endif

PACKAGE = "{{ package }}"
NAMESPACE = "{{ namespace }}"
CONTROLLERS = [
    # % for name in controllers
    "{{ name }}",
    # % endfor
]


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
    config = os.path.join(SHARE, "config")
    hardware = LaunchConfiguration("hardware").perform(context)
    has_clock = hardware == "mujoco"
    use_sim_time = {"use_sim_time": has_clock}
    package = "mujoco_ros2_control" if has_clock else "controller_manager"
    # % if command_topic
    with open(os.path.join(SHARE, "urdf", f"robot_{hardware}.urdf"), encoding="utf-8") as file:
        description = file.read().replace("$(find {{ package }})", SHARE)
    # % endif
    return [
        Node(
            package=package,
            executable="ros2_control_node",
            name="controller_manager",
            namespace=NAMESPACE,
            output="screen",
            parameters=[os.path.join(config, "controllers.yaml"), use_sim_time],
            remappings=[{{ odometry_remapping }}],
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            name="spawner",
            namespace=NAMESPACE,
            output="screen",
            arguments=[*CONTROLLERS, "--controller-manager", "{{ controller_manager }}"],
        ),
        # % if command_topic
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                os.path.join(config, "robot_state_publisher.yaml"),
                {"robot_description": ParameterValue(description, value_type=str)},
                use_sim_time,
            ],
        ),
        Node(
            package="twist_mux",
            executable="twist_mux",
            name="twist_mux",
            namespace=NAMESPACE,
            output="screen",
            parameters=[os.path.join(config, "twist_mux.yaml"), use_sim_time],
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


# % include "other_build.py"
