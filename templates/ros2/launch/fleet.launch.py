"""All robots of the fleet {{ fleet }}, each at its place in the frame map."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# Package, name space, and place in the frame map: x, y, z in m, quaternion x, y, z, w.
ROBOTS = [
    # % for package, namespace, pose in robots
    ("{{ package }}", "{{ namespace }}", {{ pose }}),
    # % endfor
]


def robot(package, namespace, pose):
    options = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")
    place = [text for item in zip(options, pose) for text in (item[0], str(item[1]))]
    share = get_package_share_directory(package)
    # The group keeps the arguments of a robot from the others.
    return GroupAction(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(os.path.join(share, "launch", "base.launch.py")),
                launch_arguments={"base": LaunchConfiguration("base")}.items(),
            ),
            Node(
                condition=IfCondition(LaunchConfiguration("poses")),
                package="tf2_ros",
                executable="static_transform_publisher",
                name="map_to_odom",
                namespace=namespace,
                arguments=place + ["--frame-id", "map", "--child-frame-id", f"{namespace}/odom"],
            ),
        ]
    )


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "base",
                default_value="ideal",
                choices=["ideal", "virtual"],
                description="ideal joints, or simulated buses",
            ),
            DeclareLaunchArgument(
                "poses",
                default_value="true",
                description="publish the transforms from map to the odom frame of each robot",
            ),
            *[robot(*values) for values in ROBOTS],
        ]
    )
