"""Simulation with ideal joints, without physics."""

import os
import re

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

PACKAGE = "thorvald_4wd4ws_wide"


def generate_launch_description():
    """Return what this file starts."""
    base = os.path.join(SHARE, "launch", "base.launch.py")
    return launch_description(
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(base),
            launch_arguments={
                "base": "ideal",
            }.items(),
        ),
    )


SHARE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def launch_description(*entities):
    """Return these entities, or the same launch file of the build that `model` names."""
    model = LaunchConfiguration("model")
    namespace = DeclareLaunchArgument(
        "namespace",
        default_value="",
        description="begins the names of the robot: nodes, topics, joints and frames",
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "model",
                default_value="",
                description="ros2/config/model.json of another build, which is started in place of"
                " this one",
            ),
            # The group keeps the names of this robot from others that are started later.
            GroupAction(
                [namespace, OpaqueFunction(function=name_robot), *entities],
                condition=IfCondition(EqualsSubstitution(model, "")),
            ),
            OpaqueFunction(function=other_build),
        ]
    )


def name_robot(context):
    """Set the full name space of the robot, and `name_prefix`, which the files contain."""
    namespace = LaunchConfiguration("namespace").perform(context)
    if not namespace.startswith("/"):
        group = LaunchConfiguration("ros_namespace", default="").perform(context)
        namespace = f"{group}/{namespace}"
    names = [name for name in namespace.split("/") if name]
    if not all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) for name in names):
        raise RuntimeError(
            f"namespace is {namespace}; expected names of letters, digits and underscores with"
            " slashes between them, such as r1"
        )
    return [
        SetLaunchConfiguration("namespace", "/" + "/".join(names)),
        SetLaunchConfiguration("name_prefix", "".join(f"{name}/" for name in names)),
    ]


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
