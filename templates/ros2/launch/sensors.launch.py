"""The drivers of the sensors of the real robot, each of which is started again when it ends."""

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
from launch_ros.parameter_descriptions import ParameterFile

PACKAGE = "{{ package }}"
SPACE = ["/", LaunchConfiguration("name_prefix")]


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
        # % for node in sensor_nodes
        Node(
            package="{{ node.package }}",
            executable="{{ node.executable }}",
            name="{{ node.name }}",
            namespace=[*SPACE, "{{ node.space }}"],
            output="screen",
            parameters=[parameters("sensors")],
            # % if node.remappings
            remappings=[
                # % for theirs, ours in node.remappings
                ("{{ theirs }}", "{{ ours }}"),
                # % endfor
            ],
            # % endif
            respawn=True,
            respawn_delay=2.0,
        ),
        # % endfor
    )


# % include "parameters.py"
# % include "other_build.py"
