"""{{ summary }}"""

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
# % if own
from launch.launch_description_sources import (
    AnyLaunchDescriptionSource,
    PythonLaunchDescriptionSource,
)
# % else
from launch.launch_description_sources import PythonLaunchDescriptionSource
# % endif
from launch.substitutions import EqualsSubstitution, LaunchConfiguration

PACKAGE = "{{ package }}"


def generate_launch_description():
    """Return what this file starts."""
    base = os.path.join(SHARE, "launch", "base.launch.py")
    return launch_description(
        # % if is_real and sensor_nodes
        DeclareLaunchArgument(
            "sensors", default_value="true", description="start the drivers of the sensors"
        ),
        # % endif
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(base),
            launch_arguments={
                # % for name, value in arguments.items()
                "{{ name }}": "{{ value }}",
                # % endfor
            }.items(),
        ),
        # % if is_real and sensor_nodes
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(SHARE, "launch", "sensors.launch.py")),
            condition=IfCondition(LaunchConfiguration("sensors")),
        ),
        # % endif
        # % for name in own
        IncludeLaunchDescription(
            AnyLaunchDescriptionSource(os.path.join(SHARE, "launch", "{{ name }}"))
        ),
        # % endfor
    )


# % include "other_build.py"
