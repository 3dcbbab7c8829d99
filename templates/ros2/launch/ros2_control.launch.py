"""Controllers of ros2_control move the robot, without the base driver."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = "{{ namespace }}"
CONTROLLERS = [
    # % for name in controllers
    "{{ name }}",
    # % endfor
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
    with open(os.path.join(share, "urdf", f"robot_{hardware}.urdf"), encoding="utf-8") as file:
        description = file.read().replace("$(find {{ package }})", share)
    use_sim_time = {"use_sim_time": hardware == "mujoco"}
    package = "mujoco_ros2_control" if hardware == "mujoco" else "controller_manager"
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                os.path.join(config, "robot_state_publisher.yaml"),
                {"robot_description": ParameterValue(description, value_type=str)},
                use_sim_time,
            ],
        ),
        Node(
            package=package,
            executable="ros2_control_node",
            name="controller_manager",
            namespace=NAMESPACE,
            output="screen",
            parameters=[os.path.join(config, "controllers.yaml"), use_sim_time],
            remappings=[{{ odometry_remapping }}],
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            name="spawner",
            namespace=NAMESPACE,
            output="screen",
            arguments=[*CONTROLLERS, "--controller-manager", "{{ controller_manager }}"],
        ),
        # % if command_topic
        Node(
            package="twist_mux",
            executable="twist_mux",
            name="twist_mux",
            namespace=NAMESPACE,
            output="screen",
            parameters=[os.path.join(config, "twist_mux.yaml"), use_sim_time],
            remappings=[("cmd_vel_out", "{{ command_topic }}")],
        ),
        # % endif
    ]
