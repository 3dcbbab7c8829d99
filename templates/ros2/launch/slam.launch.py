"""slam_toolbox makes a map and gives the pose in it."""

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
    use_sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    return launch_description(
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="take the time from /clock"
        ),
        Node(
            package="slam_toolbox",
            executable="async_slam_toolbox_node",
            name="slam_toolbox",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("slam_toolbox"), use_sim_time],
        ),
        # slam_toolbox is a lifecycle node without the bond of Nav2's nodes.
        Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name="lifecycle_manager_slam",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                {"autostart": True, "node_names": ["slam_toolbox"], "bond_timeout": 0.0},
                use_sim_time,
            ],
        ),
    )


# % include "parameters.py"
# % include "other_build.py"
