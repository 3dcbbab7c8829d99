"""A pad moves the robot, while its upper left or right button is held."""

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
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = ""


def generate_launch_description():
    """Return what this file starts."""
    config = os.path.join(SHARE, "config", "teleop_twist_joy.yaml")

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    # Stamps of another clock than the driver's are refused.
    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    return launch_description(
        DeclareLaunchArgument(
            "teleop_controller",
            default_value="",
            description="name of the pad as SDL reports it; default: the first pad",
        ),
        DeclareLaunchArgument(
            "stamped",
            default_value="false",
            description="TwistStamped in place of Twist; ros2_control needs true",
        ),
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="take the time from /clock"
        ),
        Node(
            package="joy",
            executable="game_controller_node",
            name="game_controller_node",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                config,
                {"device_name": argument("teleop_controller", str)},
                use_sim_time,
            ],
        ),
        Node(
            package="teleop_twist_joy",
            executable="teleop_node",
            name="teleop_twist_joy_node",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                config,
                {"publish_stamped_twist": argument("stamped", bool)},
                use_sim_time,
            ],
            remappings=[("cmd_vel", "teleop_joy/cmd_vel")],
        ),
    )


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
