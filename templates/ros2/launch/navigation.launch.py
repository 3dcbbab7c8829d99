"""Nav2 and its localization; the robot must run already."""

import os
import re

# % if not turns_on_the_spot
from ament_index_python.packages import get_package_share_directory
# % endif
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

PACKAGE = "{{ package }}"
NAMESPACE = LaunchConfiguration("namespace")


def generate_launch_description():
    """Return what this file starts."""
    # % if map_sources
    launch = os.path.join(SHARE, "launch")
    # % endif
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
            default_value="{{ localizations[0] }}",
            choices=["{{ localizations | join('", "') }}"],
            description="node that publishes the transform from map to odom",
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=os.path.join(SHARE, "config", "nav2.yaml"),
            description="parameters of Nav2 that replace those of this package",
        ),
        DeclareLaunchArgument(
            "stamped",
            default_value="{{ stamped }}",
            description="TwistStamped in place of Twist; ros2_control needs true",
        ),
        GroupAction(
            [
                SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
                # % for source in map_sources
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(os.path.join(launch, "{{ source }}.launch.py")),
                    condition=IfCondition(EqualsSubstitution(localization, "{{ source }}")),
                ),
                # % endfor
                node("nav2_controller", "controller_server", remappings=out),
                node("nav2_smoother", "smoother_server"),
                node("nav2_planner", "planner_server", costmap),
                node("nav2_behaviors", "behavior_server", remappings=out),
                # % if turns_on_the_spot
                node("nav2_bt_navigator", "bt_navigator"),
                # % else
                # # The recoveries of the default tree would turn the robot on the spot.
                node("nav2_bt_navigator", "bt_navigator", {
                    "default_nav_to_pose_bt_xml": os.path.join(
                        get_package_share_directory("nav2_bt_navigator"),
                        "behavior_trees",
                        "navigate_w_replanning_time.xml",
                    )
                }),
                # % endif
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


# % include "parameters.py"
# % include "other_build.py"
