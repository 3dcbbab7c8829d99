"""The robot's description and its base driver; other launch files include it."""

import atexit
import os
import re
import shutil
import tempfile

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    SetLaunchConfiguration,
    Shutdown,
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = LaunchConfiguration("namespace")
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
    "required": ("true", "the launch ends when the base driver or the guard has ended"),
    "urdf": ("robot.urdf", "the robot's description in the folder urdf"),
    "diagnostics": ("false", "start diagnostic_aggregator, one for all robots of a domain"),
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

    def argument(name, value_type):
        return ParameterValue(LaunchConfiguration(name), value_type=value_type)

    use_sim_time = {"use_sim_time": argument("use_sim_time", bool)}
    joints = {
        "model_file": os.path.join(SHARE, "config", "model.json"),
        "use_node_namespace": True,
        "joint_topics": argument("joint_topics", str),
    }
    rviz = copies_of(context, "rviz/robot.rviz")
    is_required = LaunchConfiguration("required").perform(context).lower() == "true"
    on_exit = end_launch if is_required else None
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            namespace=NAMESPACE,
            output="screen",
            parameters=[
                parameters("robot_state_publisher"),
                description_of(context, LaunchConfiguration("urdf").perform(context)),
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
                parameters("base_driver"),
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
            on_exit=on_exit,
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
            on_exit=on_exit,
        ),
        Node(
            condition=IfCondition(LaunchConfiguration("diagnostics")),
            package="diagnostic_aggregator",
            executable="aggregator_node",
            name="analyzers",
            namespace=NAMESPACE,
            output="screen",
            parameters=[parameters("diagnostics"), use_sim_time],
        ),
        Node(
            condition=IfCondition(LaunchConfiguration("rviz")),
            package="rviz2",
            executable="rviz2",
            name="rviz2",
            namespace=NAMESPACE,
            arguments=["-d", os.path.join(rviz, "robot.rviz")],
            parameters=[use_sim_time],
        ),
    ]


def end_launch(event, context):
    """End all that this launch has started, so that its supervisor can start it again."""
    if event.returncode:
        # An error in a launch ends it too; with Shutdown, its exit status would be 0.
        raise RuntimeError(f"{event.process_name} has ended with status {event.returncode}")
    return Shutdown(reason=f"{event.process_name} has ended")


def parameters(*name):
    """Return the parameters in a file of the folder config, with the names of the robot."""
    return ParameterFile([os.path.join(SHARE, "config", ""), *name, ".yaml"], allow_substs=True)


def text_of(context, path):
    """Return the text of a file of this package with the names of the robot."""
    with open(os.path.join(SHARE, path), encoding="utf-8") as file:
        text = file.read().replace("$(find thorvald_4wd4ws_wide)", SHARE)
    for name in ("name_prefix", "namespace"):
        text = text.replace(f"$(var {name})", LaunchConfiguration(name).perform(context))
    if LaunchConfiguration("driver_package", default="").perform(context):
        # Another package has started this build, which may not be installed.
        for scheme in ("package", "model"):
            text = text.replace(f"{scheme}://thorvald_4wd4ws_wide/", f"file://{SHARE}/")
    return text


def copies_of(context, *paths):
    """Return a folder with copies of files of this package that have the names of the robot."""
    folder = tempfile.mkdtemp(prefix="thorvald_4wd4ws_wide_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path in paths:
        text = text_of(context, path).replace('"../meshes/', f'"{SHARE}/meshes/')
        with open(os.path.join(folder, os.path.basename(path)), "w", encoding="utf-8") as file:
            file.write(text)
    return folder


def description_of(context, urdf):
    """Return the robot_description in a file of the folder urdf, with the names of the robot."""
    text, scene = text_of(context, f"urdf/{urdf}"), os.path.join(SHARE, "mjcf")
    if scene in text:
        text = text.replace(scene, copies_of(context, "mjcf/robot.xml", "mjcf/scene.xml"))
    return {"robot_description": ParameterValue(text, value_type=str)}


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
