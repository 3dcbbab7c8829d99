"""GNSS, odometry and IMU give the pose in the frame map."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = "{{ namespace }}"


def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
    config = os.path.join(share, "config")
    use_sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="take the time from /clock"
            ),
            Node(
                package="robot_localization",
                executable="ekf_node",
                name="ekf_map",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "gnss.yaml"), use_sim_time],
                remappings=[("odometry/filtered", "odometry/filtered_map")],
            ),
            Node(
                package="robot_localization",
                executable="navsat_transform_node",
                name="navsat_transform",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "gnss.yaml"), use_sim_time],
                remappings=[
                    ("odometry/filtered", "odometry/filtered_map"),
                    ("gps/fix", "{{ gnss_topic }}"),
                    # % if imu_topic
                    ("imu", "{{ imu_topic }}"),
                    # % endif
                ],
            ),
        ]
    )
