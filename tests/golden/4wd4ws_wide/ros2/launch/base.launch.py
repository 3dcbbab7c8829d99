"""The robot's description and its base driver; other launch files include it."""

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
ARGUMENTS = {
    "bus": ("socketcan:can0", "CAN interface of the robot's bus, as in thorvaldc run --bus"),
    "guard": ("false", "stop the drives of another program when the base driver is silent"),
    "real_time_factor": ("1.0", "speed of a simulation; 0.0: as fast as possible"),
    "world": ("", "build of a scenario with this robot, for MuJoCo"),
    "use_sim_time": ("false", "take the time from /clock"),
    "publish_clock": ("false", "publish /clock"),
    "enable_odom_tf": (
        "true",
        "the base driver publishes the transform from odom to base_link",
    ),
    "urdf": ("robot.urdf", "the robot's description in the folder urdf"),
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
    config = os.path.join(SHARE, "config")
    urdf = LaunchConfiguration("urdf").perform(context)
    with open(os.path.join(SHARE, "urdf", urdf), encoding="utf-8") as file:
        description = file.read().replace("$(find thorvald_4wd4ws_wide)", SHARE)
    if driver:  # of the package that started this build, which may not be installed
        meshes = "package://thorvald_4wd4ws_wide/"
        description = description.replace(meshes, f"file://{SHARE}/")

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    joints = {
        "model_file": os.path.join(config, "model.json"),
        "joint_topics": argument("joint_topics", str),
    }
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                os.path.join(config, "robot_state_publisher.yaml"),
                {"robot_description": ParameterValue(description, value_type=str)},
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
                os.path.join(config, "base_driver.yaml"),
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
        ),
        Node(
            condition=IfCondition(LaunchConfiguration("rviz")),
            package="rviz2",
            executable="rviz2",
            name="rviz2",
            namespace=NAMESPACE,
            arguments=["-d", os.path.join(SHARE, "rviz", "robot.rviz")],
            parameters=[use_sim_time],
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
