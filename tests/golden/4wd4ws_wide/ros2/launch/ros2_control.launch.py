"""Joints of ros2_control, which its controllers move, or the base driver through them."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = ""
CONTROLLERS = [
    "joint_state_broadcaster",
    "drive_velocity_controller",
    "steering_position_controller",
]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "hardware",
                default_value="mock",
                choices=["mock", "mujoco"],
                description="ideal joints, or joints in MuJoCo by mujoco_ros2_control",
            ),
            OpaqueFunction(function=start),
        ]
    )


def start(context):
    share = get_package_share_directory(PACKAGE)
    config = os.path.join(share, "config")
    hardware = LaunchConfiguration("hardware").perform(context)
    has_clock = hardware == "mujoco"
    use_sim_time = {"use_sim_time": has_clock}
    package = "mujoco_ros2_control" if has_clock else "controller_manager"
    return [
        Node(
            package=package,
            executable="ros2_control_node",
            name="controller_manager",
            namespace=NAMESPACE,
            output="screen",
            parameters=[os.path.join(config, "controllers.yaml"), use_sim_time],
            remappings=[],
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            name="spawner",
            namespace=NAMESPACE,
            output="screen",
            arguments=[*CONTROLLERS, "--controller-manager", "/controller_manager"],
        ),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(share, "launch", "base.launch.py")),
            launch_arguments={
                "base": "topics",
                "joint_topics": "ros2_control",
                "guard": "true",
                "use_sim_time": str(has_clock).lower(),
                "urdf": f"robot_{hardware}.urdf",
            }.items(),
        ),
    ]
