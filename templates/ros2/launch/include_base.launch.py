"""{{ summary }}"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

PACKAGE = "{{ package }}"
NAMESPACE = "{{ namespace }}"


def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
    base = os.path.join(share, "launch", "base.launch.py")
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(base),
                launch_arguments={
                    # % for name, value in arguments.items()
                    "{{ name }}": "{{ value }}",
                    # % endfor
                }.items(),
            )
        ]
    )
