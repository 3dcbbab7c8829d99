"""A pad moves the robot, while its upper left or right button is held."""

import os
import re

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


def generate_launch_description():
    """Return what this file starts."""

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    # Stamps of another clock than the driver's are refused.
    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    return launch_description(
        DeclareLaunchArgument(
            "teleop_controller",
            default_value="",
            description="name of the pad as SDL reports it; default: the first pad",
        ),
        DeclareLaunchArgument(
            "stamped",
            default_value="{{ stamped }}",
            description="TwistStamped in place of Twist; ros2_control needs true",
        ),
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="take the time from /clock"
        ),
        Node(
            package="joy",
            executable="game_controller_node",
            name="game_controller_node",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("teleop_twist_joy"),
                {"device_name": argument("teleop_controller", str)},
                use_sim_time,
            ],
        ),
        Node(
            package="teleop_twist_joy",
            executable="teleop_node",
            name="teleop_twist_joy_node",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("teleop_twist_joy"),
                {"publish_stamped_twist": argument("stamped", bool)},
                use_sim_time,
            ],
            remappings=[("cmd_vel", "{{ teleop_topic }}")],
        ),
    )


# % include "parameters.py"
# % include "other_build.py"
