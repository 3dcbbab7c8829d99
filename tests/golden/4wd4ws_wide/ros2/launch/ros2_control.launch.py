"""Joints of ros2_control, which its controllers move, or the base driver through them."""

import os

from launch import LaunchDescription
from launch.actions import (
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

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = ""
CONTROLLERS = [
    "joint_state_broadcaster",
    "drive_velocity_controller",
    "steering_position_controller",
]


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
        DeclareLaunchArgument(
            "hardware",
            default_value="mock",
            choices=["mock", "mujoco"],
            description="ideal joints, or joints in MuJoCo by mujoco_ros2_control",
        ),
        OpaqueFunction(function=start),
    )


def start(context):
    """Return the nodes."""
    config = os.path.join(SHARE, "config")
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
            PythonLaunchDescriptionSource(os.path.join(SHARE, "launch", "base.launch.py")),
            launch_arguments={
                "base": "topics",
                "joint_topics": "ros2_control",
                "guard": "true",
                "use_sim_time": str(has_clock).lower(),
                "urdf": f"robot_{hardware}.urdf",
            }.items(),
        ),
    ]


SHARE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def launch_description(*entities):
    """Return these entities, or the same launch file of the build that `model` names."""
    model = LaunchConfiguration("model")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "model",
                default_value="",
                description="ros2/config/model.json of another build, which is started in place of"
                " this one",
            ),
            GroupAction(
                list(entities), scoped=False, condition=IfCondition(EqualsSubstitution(model, ""))
            ),
            OpaqueFunction(function=other_build),
        ]
    )


def other_build(context):
    """Include the launch file of the other build; it starts the base driver of this package."""
    model = LaunchConfiguration("model").perform(context)
    if not model:
        return []
    share = os.path.dirname(os.path.dirname(os.path.abspath(model)))
    launch = os.path.join(share, "launch", os.path.basename(__file__))
    if not os.path.isfile(launch):
        raise RuntimeError(
            f"model is {model}; expected ros2/config/model.json of a build that has the launch"
            f" file {os.path.basename(__file__)}"
        )
    # The group keeps the settings from what is started later.
    return [
        GroupAction(
            [
                SetLaunchConfiguration("driver_package", PACKAGE),
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(launch), launch_arguments={"model": ""}.items()
                ),
            ]
        )
    ]
