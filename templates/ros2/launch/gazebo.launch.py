"""Simulation in Gazebo, which gives the time of all nodes."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    AppendEnvironmentVariable,
    DeclareLaunchArgument,
    IncludeLaunchDescription,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = "{{ namespace }}"
# % if command_topic
CONTROLLERS = [
    # % for name in controllers
    "{{ name }}",
    # % endfor
]
# % endif


def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
    config = os.path.join(share, "config")
    with open(os.path.join(share, "urdf", "{{ urdf }}"), encoding="utf-8") as file:
        description = file.read().replace("$(find {{ package }})", share)
    with open(os.path.join(share, "sdf", "model.sdf"), encoding="utf-8") as file:
        model = file.read().replace("$(find {{ package }})", share)
    use_sim_time = {"use_sim_time": True}
    gazebo = get_package_share_directory("ros_gz_sim")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "gz_args", default_value="-r", description="options of gz sim; -r -s: no window"
            ),
            # Gazebo finds the meshes of the package in this folder.
            AppendEnvironmentVariable("GZ_SIM_RESOURCE_PATH", os.path.dirname(share)),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(os.path.join(gazebo, "launch", "gz_sim.launch.py")),
                launch_arguments={
                    "gz_args": [
                        LaunchConfiguration("gz_args"),
                        " ",
                        os.path.join(share, "sdf", "world.sdf"),
                    ]
                }.items(),
            ),
            Node(
                package="ros_gz_sim",
                executable="create",
                name="create",
                namespace=NAMESPACE,
                output="screen",
                arguments=["-name", "{{ model_name }}", "-string", model],
            ),
            Node(
                package="ros_gz_bridge",
                executable="parameter_bridge",
                name="gz_bridge",
                namespace=NAMESPACE,
                output="screen",
                parameters=[{"config_file": os.path.join(config, "gz_bridge.yaml")}, use_sim_time],
            ),
            # Gazebo sends the time at every step of the physics; the nodes get every 10th.
            Node(
                package="topic_tools",
                executable="drop",
                name="clock_drop",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    {
                        "input_topic": "{{ gazebo_clock }}",
                        "output_topic": "/clock",
                        "X": 9,
                        "Y": 10,
                    }
                ],
            ),
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
            # % if command_topic
            Node(
                package="controller_manager",
                executable="spawner",
                name="spawner",
                namespace=NAMESPACE,
                output="screen",
                arguments=[*CONTROLLERS, "--controller-manager", "{{ controller_manager }}"],
            ),
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
    )
