import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node


def generate_launch_description():
    share = get_package_share_directory("cart")
    nodes = [
        Node(
            package="robot_localization",
            executable="ekf_node",
            parameters=[os.path.join(share, "config", "ekf.yaml")],
        ),
        Node(
            package="rplidar_ros",
            executable="rplidar_node",
            name="lidar",
            parameters=[{"frame_id": "lidar_link", "angle_compensate": True}],
        ),
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            arguments=["--frame-id", "base_link", "--child-frame-id", "camera_link"],
        ),
    ]
    description = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(os.path.join(share, "launch", "description.launch.py"))
    )
    return LaunchDescription([description, *nodes])
