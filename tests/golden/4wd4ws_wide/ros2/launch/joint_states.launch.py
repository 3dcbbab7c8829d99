"""The robot in Isaac Sim, or in another program that takes and sends JointState messages."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = ""


def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
    base = os.path.join(share, "launch", "base.launch.py")
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(base),
                launch_arguments={
                    "base": "topics",
                    "joint_topics": "joint_states",
                    "guard": "true",
                    "use_sim_time": "true",
                }.items(),
            )
        ]
    )
