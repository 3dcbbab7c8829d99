"""All robots of the fleet {{ fleet }}, each at its place in the frame map."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "{{ package }}"
# Package, name space, and place in the frame map: x, y, z in m, quaternion x, y, z, w, and the
# angles roll, pitch, yaw in rad.
ROBOTS = [
    # % for package, namespace, pose, angles in robots
    ("{{ package }}", "{{ namespace }}", {{ pose }}, {{ angles }}),
    # % endfor
]


# Number of the robot with the shortest control cycle: with MuJoCo, its node publishes /clock.
CLOCK = {{ clock }}


def robot(number, base, group, package, namespace, pose, angles):
    """Return a robot of the fleet at its place, in the name space of the group."""
    namespace = f"{group}/{namespace}".lstrip("/")
    options = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")
    place = [text for item in zip(options, pose) for text in (item[0], str(item[1]))]
    share = get_package_share_directory(package)
    file, arguments = "base.launch.py", {"base": base}
    if base == "mujoco":
        arguments |= {"use_sim_time": "true", "publish_clock": str(number == CLOCK).lower()}
    if base == "gazebo":
        world = os.path.join(get_package_share_directory(PACKAGE), "sdf", "world.sdf")
        places = zip(("x", "y", "z", "R", "P", "Y"), (*pose[:3], *angles))
        file = "gazebo.launch.py"
        # One Gazebo runs, with the world of the fleet.
        arguments = {"world": world if number == 0 else "", **{k: str(v) for k, v in places}}
    # A launch can end as a whole only, and the other robots go on when a base driver has ended: the
    # motor controllers or the guard of its robot stop it.
    arguments["required"] = "false"
    # The group keeps the arguments of a robot from the others.
    return GroupAction(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(os.path.join(share, "launch", file)),
                launch_arguments={**arguments, "namespace": f"/{namespace}"}.items(),
            ),
            Node(
                condition=IfCondition(LaunchConfiguration("poses")),
                package="tf2_ros",
                executable="static_transform_publisher",
                name="map_to_odom",
                namespace=f"/{namespace}",
                arguments=place + ["--frame-id", "map", "--child-frame-id", f"{namespace}/odom"],
            ),
        ]
    )


def start(context):
    """Return all robots."""
    base = LaunchConfiguration("base").perform(context)
    group = LaunchConfiguration("ros_namespace", default="").perform(context)
    return [robot(number, base, group, *values) for number, values in enumerate(ROBOTS)]


def generate_launch_description():
    """Return what this file starts."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "base",
                default_value="ideal",
                choices=["ideal", "mujoco", "virtual", "gazebo"],
                description="ideal joints, a MuJoCo for each robot, which does not see the others,"
                " simulated buses, or one Gazebo with all robots",
            ),
            DeclareLaunchArgument(
                "poses",
                default_value="true",
                description="publish the transforms from map to the odom frame of each robot",
            ),
            OpaqueFunction(function=start),
        ]
    )
