import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource


def generate_launch_description():
    ui_folder = get_package_share_directory("devkit_ui")
    ui = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(os.path.join(ui_folder, "launch", "ui.launch.py"))
    )
    return LaunchDescription([ui])
