"""Nav2 and its localization; the robot must run already."""

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
from launch_ros.actions import Node, SetParameter
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = LaunchConfiguration("namespace")


def generate_launch_description():
    """Return what this file starts."""
    launch = os.path.join(SHARE, "launch")
    localization = LaunchConfiguration("localization")
    stamped = {
        "enable_stamped_cmd_vel": ParameterValue(LaunchConfiguration("stamped"), value_type=bool)
    }

    def node(package, name, *more, remappings=()):
        return Node(
            package=package,
            executable=name,
            name=name,
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("nav2"), *more, own, stamped],
            remappings=remappings,
        )

    # velocity_smoother and collision_monitor pass the twists on to the base driver.
    out = [("cmd_vel", "cmd_vel_nav")]
    costmap = parameters("global_costmap_", localization)
    own = ParameterFile(LaunchConfiguration("params_file"), allow_substs=True)
    return launch_description(
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="take the time from /clock"
        ),
        DeclareLaunchArgument(
            "localization",
            default_value="slam",
            choices=["slam", "gnss", "amcl"],
            description="node that publishes the transform from map to odom",
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=os.path.join(SHARE, "config", "nav2.yaml"),
            description="parameters of Nav2 that replace those of this package",
        ),
        DeclareLaunchArgument(
            "stamped",
            default_value="false",
            description="TwistStamped in place of Twist; ros2_control needs true",
        ),
        GroupAction(
            [
                SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(os.path.join(launch, "slam.launch.py")),
                    condition=IfCondition(EqualsSubstitution(localization, "slam")),
                ),
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(os.path.join(launch, "gnss.launch.py")),
                    condition=IfCondition(EqualsSubstitution(localization, "gnss")),
                ),
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(os.path.join(launch, "amcl.launch.py")),
                    condition=IfCondition(EqualsSubstitution(localization, "amcl")),
                ),
                node("nav2_controller", "controller_server", remappings=out),
                node("nav2_smoother", "smoother_server"),
                node("nav2_planner", "planner_server", costmap),
                node("nav2_behaviors", "behavior_server", remappings=out),
                node("nav2_bt_navigator", "bt_navigator"),
                node("nav2_waypoint_follower", "waypoint_follower"),
                node("nav2_velocity_smoother", "velocity_smoother", remappings=out),
                node("nav2_collision_monitor", "collision_monitor"),
                Node(
                    package="nav2_lifecycle_manager",
                    executable="lifecycle_manager",
                    name="lifecycle_manager_navigation",
                    namespace=NAMESPACE,
                    output="screen",
                    parameters=[{"autostart": True, "node_names": NODES}],
                ),
            ]
        ),
    )


NODES = [
    "controller_server",
    "smoother_server",
    "planner_server",
    "behavior_server",
    "bt_navigator",
    "waypoint_follower",
    "velocity_smoother",
    "collision_monitor",
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
