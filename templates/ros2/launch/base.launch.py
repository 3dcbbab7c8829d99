"""The robot's description and its base driver; other launch files include it."""

import atexit
import os
import re
import shutil
import tempfile

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    SetLaunchConfiguration,
    Shutdown,
)
# % if local_ekf
from launch.conditions import IfCondition, UnlessCondition
# % else
from launch.conditions import IfCondition
# % endif
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = LaunchConfiguration("namespace")
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
    "required": ("true", "the launch ends when the base driver or the guard has ended"),
    "urdf": ("robot.urdf", "the robot's description in the folder urdf"),
    "diagnostics": ("false", "start diagnostic_aggregator, one for all robots of a domain"),
    "rviz": ("false", "start RViz"),
}


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
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
    )


def start(context):
    """Return the nodes."""
    driver = LaunchConfiguration("driver_package", default="").perform(context)

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    joints = {
        "model_file": os.path.join(SHARE, "config", "model.json"),
        "use_node_namespace": True,
        "joint_topics": argument("joint_topics", str),
    }
    rviz = copies_of(context, "rviz/robot.rviz")
    is_required = LaunchConfiguration("required").perform(context).lower() == "true"
    on_exit = end_launch if is_required else None
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("robot_state_publisher"),
                description_of(context, LaunchConfiguration("urdf").perform(context)),
                use_sim_time,
            ],
        ),
        Node(
            package=driver or PACKAGE,
            executable="base_driver",
            name="base_driver",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("base_driver"),
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
            on_exit=on_exit,
        ),
        # The other program keeps the last commands, also when the base driver has ended.
        Node(
            condition=IfCondition(LaunchConfiguration("guard")),
            package=driver or PACKAGE,
            executable="joint_guard",
            name="joint_guard",
            namespace=NAMESPACE,
            output="screen",
            parameters=[joints, use_sim_time],
            on_exit=on_exit,
        ),
        # % if local_ekf
        Node(
            condition=UnlessCondition(LaunchConfiguration("enable_odom_tf")),
            package="robot_localization",
            executable="ekf_node",
            name="ekf_odom",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("ekf_odom"), use_sim_time],
        ),
        # % endif
        Node(
            condition=IfCondition(LaunchConfiguration("diagnostics")),
            package="diagnostic_aggregator",
            executable="aggregator_node",
            name="analyzers",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("diagnostics"), use_sim_time],
        ),
        Node(
            condition=IfCondition(LaunchConfiguration("rviz")),
            package="rviz2",
            executable="rviz2",
            name="rviz2",
            namespace=NAMESPACE,
            arguments=["-d", os.path.join(rviz, "robot.rviz")],
            parameters=[use_sim_time],
        ),
    ]


def end_launch(event, context):
    """End all that this launch has started, so that its supervisor can start it again."""
    if event.returncode:
        # An error in a launch ends it too; with Shutdown, its exit status would be 0.
        raise RuntimeError(f"{event.process_name} has ended with status {event.returncode}")
    return Shutdown(reason=f"{event.process_name} has ended")


# % include "named_files.py"
# % include "other_build.py"
