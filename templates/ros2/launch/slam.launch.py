"""slam_toolbox makes a map and gives the pose in it."""

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
                package="slam_toolbox",
                executable="async_slam_toolbox_node",
                name="slam_toolbox",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "slam_toolbox.yaml"), use_sim_time],
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
        ]
    )
