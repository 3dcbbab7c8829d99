"""The robot's description and its base driver; other launch files include it."""

import json
import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
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
ARGUMENTS = {
    "bus": ("{{ bus }}", "CAN interface of the robot's bus, as in thorvaldc run --bus"),
    "guard": ("false", "stop the drives of another program when the base driver is silent"),
    "real_time_factor": ("1.0", "speed of a simulation; 0.0: as fast as possible"),
    "world": ("", "build of a scenario with this robot, for MuJoCo"),
    "use_sim_time": ("false", "take the time from /clock"),
    "publish_clock": ("false", "publish /clock"),
    "enable_odom_tf": (
        "{{ odom_tf }}",
        "the base driver publishes the transform from odom to base_link",
    ),
    "urdf": ("robot.urdf", "the robot's description in the folder urdf"),
    "model": ("", "ros2/config/model.json of another build, which is started in place of this one"),
    "rviz": ("false", "start RViz"),
}


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "base",
                default_value="bus",
                choices=["ideal", "mujoco", "virtual", "bus", "topics"],
                description="ideal joints, MuJoCo, a simulated bus, the robot's bus, or topics",
            ),
            DeclareLaunchArgument(
                "joint_topics",
                default_value="gazebo",
                choices=["gazebo", "ros2_control", "joint_states"],
                description="the other program behind the topics of the joints",
            ),
            *[
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, (value, text) in ARGUMENTS.items()
            ],
            OpaqueFunction(function=start),
        ]
    )


def start(context):
    share = get_package_share_directory(PACKAGE)
    model = LaunchConfiguration("model").perform(context)
    namespace = NAMESPACE
    if model:
        share = folder_of(model)
        with open(model, encoding="utf-8") as file:
            robot = json.load(file)["model"]
        namespace = robot["namespace"]
    config = os.path.join(share, "config")
    urdf = LaunchConfiguration("urdf").perform(context)
    with open(os.path.join(share, "urdf", urdf), encoding="utf-8") as file:
        description = file.read().replace("$(find {{ package }})", share)

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    joints = {
        "model_file": os.path.join(config, "model.json"),
        "joint_topics": argument("joint_topics", str),
    }
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=namespace,
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
            namespace=namespace,
            output="screen",
            parameters=[
                os.path.join(config, "base_driver.yaml"),
                {
                    **joints,
                    "base": argument("base", str),
                    "bus": argument("bus", str),
                    "real_time_factor": argument("real_time_factor", float),
                    "world": argument("world", str),
                    "publish_clock": argument("publish_clock", bool),
                    "enable_odom_tf": argument("enable_odom_tf", bool),
                },
                use_sim_time,
            ],
        ),
        # The other program keeps the last commands, also when the base driver has ended.
        Node(
            condition=IfCondition(LaunchConfiguration("guard")),
            package=PACKAGE,
            executable="joint_guard",
            name="joint_guard",
            namespace=namespace,
            output="screen",
            parameters=[joints, use_sim_time],
        ),
        # % if local_ekf
        Node(
            condition=UnlessCondition(LaunchConfiguration("enable_odom_tf")),
            package="robot_localization",
            executable="ekf_node",
            name="ekf_odom",
            namespace=namespace,
            output="screen",
            parameters=[os.path.join(config, "ekf_odom.yaml"), use_sim_time],
        ),
        # % endif
        Node(
            condition=IfCondition(LaunchConfiguration("rviz")),
            package="rviz2",
            executable="rviz2",
            name="rviz2",
            namespace=namespace,
            arguments=["-d", os.path.join(share, "rviz", "robot.rviz")],
            parameters=[use_sim_time],
        ),
    ]


# % include "other_build.py"
