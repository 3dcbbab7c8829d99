"""The robot's description and its base driver; other launch files include it."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
# % if local_ekf
from launch.conditions import IfCondition, UnlessCondition
# % else
from launch.conditions import IfCondition
# % endif
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = "{{ namespace }}"


def generate_launch_description():
    share = get_package_share_directory(PACKAGE)
    config = os.path.join(share, "config")
    with open(os.path.join(share, "urdf", "robot.urdf"), encoding="utf-8") as file:
        description = file.read()

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "base",
                default_value="bus",
                choices=["ideal", "mujoco", "virtual", "bus"],
                description="ideal joints, MuJoCo, a simulated bus, or the robot's bus",
            ),
            DeclareLaunchArgument(
                "bus",
                default_value="{{ bus }}",
                description="CAN interface of the robot's bus, as in thorvaldc run --bus",
            ),
            DeclareLaunchArgument(
                "real_time_factor",
                default_value="1.0",
                description="speed of a simulation; 0.0: as fast as possible",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="take the time from /clock"
            ),
            DeclareLaunchArgument(
                "publish_clock", default_value="false", description="publish /clock"
            ),
            DeclareLaunchArgument(
                "enable_odom_tf",
                default_value="{{ odom_tf }}",
                description="the base driver publishes the transform from odom to base_link",
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
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
                package=PACKAGE,
                executable="base_driver",
                name="base_driver",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    os.path.join(config, "base_driver.yaml"),
                    {
                        "model_file": os.path.join(config, "model.json"),
                        "base": argument("base", str),
                        "bus": argument("bus", str),
                        "real_time_factor": argument("real_time_factor", float),
                        "publish_clock": argument("publish_clock", bool),
                        "enable_odom_tf": argument("enable_odom_tf", bool),
                    },
                    use_sim_time,
                ],
            ),
            # % if local_ekf
            Node(
                condition=UnlessCondition(LaunchConfiguration("enable_odom_tf")),
                package="robot_localization",
                executable="ekf_node",
                name="ekf_odom",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "ekf_odom.yaml"), use_sim_time],
            ),
            # % endif
            Node(
                condition=IfCondition(LaunchConfiguration("rviz")),
                package="rviz2",
                executable="rviz2",
                name="rviz2",
                namespace=NAMESPACE,
                arguments=["-d", os.path.join(share, "rviz", "robot.rviz")],
                parameters=[use_sim_time],
            ),
        ]
    )
