"""AMCL gives the pose in a saved map."""

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
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = LaunchConfiguration("namespace")


def generate_launch_description():
    """Return what this file starts."""
    return launch_description(
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="take the time from /clock"
        ),
        DeclareLaunchArgument(
            "map", default_value="", description="YAML file of a map that map_saver_cli has saved"
        ),
        OpaqueFunction(function=start),
    )


def start(context):
    """Return the nodes."""
    saved_map = LaunchConfiguration("map").perform(context)
    if not os.path.isfile(saved_map):
        raise RuntimeError(f"map is {saved_map!r}; expected a saved map, such as map:=field.yaml")
    use_sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    map_file = {"yaml_filename": ParameterValue(saved_map, value_type=str)}
    return [
        Node(
            package="nav2_map_server",
            executable="map_server",
            name="map_server",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("amcl"), map_file, use_sim_time],
        ),
        Node(
            package="nav2_amcl",
            executable="amcl",
            name="amcl",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("amcl"), use_sim_time],
        ),
        Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name="lifecycle_manager_amcl",
            namespace=NAMESPACE,
            output="screen",
            parameters=[{"autostart": True, "node_names": ["map_server", "amcl"]}, use_sim_time],
        ),
    ]


def parameters(*name):
    """Return the parameters in a file of the folder config, with the names of the robot."""
    return ParameterFile([os.path.join(SHARE, "config", ""), *name, ".yaml"], allow_substs=True)


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
