"""A pad moves the robot, while its upper left or right button is held."""

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
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "teleop_controller",
                default_value="",
                description="name of the pad as SDL reports it; default: the first pad",
            ),
            DeclareLaunchArgument(
                "stamped",
                default_value="{{ stamped }}",
                description="TwistStamped in place of Twist; ros2_control needs true",
            ),
            Node(
                package="joy",
                executable="game_controller_node",
                name="game_controller_node",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "teleop_twist_joy.yaml"),
                    {
                        "device_name": ParameterValue(
                            LaunchConfiguration("teleop_controller"), value_type=str
                        )
                    },
                ],
            ),
            Node(
                package="teleop_twist_joy",
                executable="teleop_node",
                name="teleop_twist_joy_node",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "teleop_twist_joy.yaml"),
                    {
                        "publish_stamped_twist": ParameterValue(
                            LaunchConfiguration("stamped"), value_type=bool
                        )
                    },
                ],
                remappings=[("cmd_vel", "{{ teleop_topic }}")],
            ),
        ]
    )
