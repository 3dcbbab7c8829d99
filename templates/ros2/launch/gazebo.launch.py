"""Simulation in Gazebo, which gives the time of all nodes."""

import atexit
import os
import re
import shutil
import tempfile

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    AppendEnvironmentVariable,
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    SetLaunchConfiguration,
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "{{ package }}"
NAMESPACE = LaunchConfiguration("namespace")
PLACE = ("x", "y", "z", "R", "P", "Y")
# % if command_topic
CONTROLLERS = [
    # % for name in controllers
    "{{ name }}",
    # % endfor
]
MANAGER = ["/", LaunchConfiguration("name_prefix"), "controller_manager"]
# % endif


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
        DeclareLaunchArgument(
            "gz_args", default_value="-r", description="options of gz sim; -r -s: no window"
        ),
        DeclareLaunchArgument(
            "world",
            default_value=os.path.join(SHARE, "sdf", "world.sdf"),
            description="world of Gazebo; empty: Gazebo runs already, with the time on /clock",
        ),
        # % if command_topic
        DeclareLaunchArgument(
            "controller",
            default_value="base_driver",
            choices=["base_driver", "standard"],
            description="the base driver, or the controllers of ros2_control",
        ),
        # % endif
        *[
            DeclareLaunchArgument(
                name, default_value="0.0", description="place in the world, in m and rad"
            )
            for name in PLACE
        ],
        DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
        OpaqueFunction(function=start),
    )


def start(context):
    """Return Gazebo with the robot in it."""
    # % if command_topic
    standard = LaunchConfiguration("controller").perform(context) == "standard"
    variant, moved_by = ("_ros2_control", controllers) if standard else ("", base_driver)
    # % else
    variant, moved_by = "", base_driver
    # % endif
    model = text_of(context, f"sdf/model{variant}.sdf")
    bridge = f"gz_bridge{variant}.yaml"
    files = [f"config/{bridge}"]
    # % if command_topic
    files += ["config/controllers.yaml"] if standard else []
    # % endif
    config = copies_of(context, *files)
    # % if command_topic
    model = model.replace(os.path.join(SHARE, "config"), config)
    # % endif
    namespace = NAMESPACE.perform(context)[1:]
    name = namespace.replace("/", "_") or "{{ robot_name }}"
    place = [text for axis in PLACE for text in (f"-{axis}", LaunchConfiguration(axis))]
    return [
        # Gazebo finds the meshes of the package in this folder.
        AppendEnvironmentVariable("GZ_SIM_RESOURCE_PATH", os.path.dirname(SHARE)),
        *gazebo(LaunchConfiguration("world").perform(context)),
        Node(
            package="ros_gz_sim",
            executable="create",
            name="create",
            namespace=NAMESPACE,
            output="screen",
            arguments=["-name", name, "-string", model, *place],
        ),
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            name="gz_bridge",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                {"config_file": os.path.join(config, bridge)},
                {"use_sim_time": True},
            ],
        ),
        *moved_by(context),
    ]


def gazebo(world):
    """Return Gazebo with its time on /clock, or nothing if it runs already."""
    if not world:
        return []
    launch = os.path.join(get_package_share_directory("ros_gz_sim"), "launch", "gz_sim.launch.py")
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(launch),
            launch_arguments={"gz_args": [LaunchConfiguration("gz_args"), " ", world]}.items(),
        ),
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            name="gz_bridge_clock",
            namespace=NAMESPACE,
            output="screen",
            parameters=[{"config_file": os.path.join(SHARE, "config", "gz_bridge_clock.yaml")}],
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
    ]


# % if command_topic
def controllers(context):
    """Return the nodes that move the robot by ros2_control."""
    use_sim_time = {"use_sim_time": True}
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("robot_state_publisher"),
                description_of(context, "robot_gazebo.urdf"),
                use_sim_time,
            ],
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            name="spawner",
            namespace=NAMESPACE,
            output="screen",
            arguments=[*CONTROLLERS, "--controller-manager", MANAGER],
        ),
        Node(
            package="twist_mux",
            executable="twist_mux",
            name="twist_mux",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("twist_mux"), use_sim_time],
            remappings=[("cmd_vel_out", "{{ command_topic }}")],
        ),
    ]


# % endif
def base_driver(context):
    """Return the nodes that move the robot by the base driver."""
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(os.path.join(SHARE, "launch", "base.launch.py")),
            launch_arguments={
                "base": "topics",
                "joint_topics": "gazebo",
                "guard": "true",
                "use_sim_time": "true",
                "rviz": LaunchConfiguration("rviz"),
            }.items(),
        )
    ]


# % include "named_files.py"
# % include "other_build.py"
