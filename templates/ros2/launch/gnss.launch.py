"""GNSS, odometry and IMU give the pose in the frame map."""

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
            package="robot_localization",
            executable="ekf_node",
            name="ekf_map",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("gnss"), use_sim_time],
            remappings=[("odometry/filtered", "odometry/filtered_map")],
        ),
        Node(
            package="robot_localization",
            executable="navsat_transform_node",
            name="navsat_transform",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("gnss"), use_sim_time],
            remappings=[
                ("odometry/filtered", "odometry/filtered_map"),
                ("gps/fix", "{{ gnss_topic }}"),
                # % if imu_topic
                ("imu", "{{ imu_topic }}"),
                # % endif
            ],
        ),
    )


# % include "parameters.py"
# % include "other_build.py"
