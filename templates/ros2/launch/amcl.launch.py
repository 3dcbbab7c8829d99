"""AMCL gives the pose in a saved map."""

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
    return launch_description(
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="take the time from /clock"
        ),
        DeclareLaunchArgument(
            "map", default_value="", description="YAML file of a map that map_saver_cli has saved"
        ),
        OpaqueFunction(function=start),
    )


def start(context):
    """Return the nodes."""
    saved_map = LaunchConfiguration("map").perform(context)
    if not os.path.isfile(saved_map):
        raise RuntimeError(f"map is {saved_map!r}; expected a saved map, such as map:=field.yaml")
    use_sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    map_file = {"yaml_filename": ParameterValue(saved_map, value_type=str)}
    return [
        Node(
            package="nav2_map_server",
            executable="map_server",
            name="map_server",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("amcl"), map_file, use_sim_time],
        ),
        Node(
            package="nav2_amcl",
            executable="amcl",
            name="amcl",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("amcl"), use_sim_time],
        ),
        Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name="lifecycle_manager_amcl",
            namespace=NAMESPACE,
            output="screen",
            parameters=[{"autostart": True, "node_names": ["map_server", "amcl"]}, use_sim_time],
        ),
    ]


# % include "parameters.py"
# % include "other_build.py"
