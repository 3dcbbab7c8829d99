"""Joints of ros2_control, which its controllers move, or the base driver through them."""

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
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

PACKAGE = "thorvald_4wd4ws_wide"
NAMESPACE = LaunchConfiguration("namespace")
CONTROLLERS = [
    "joint_state_broadcaster",
    "drive_velocity_controller",
    "steering_position_controller",
]
MANAGER = ["/", LaunchConfiguration("name_prefix"), "controller_manager"]


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
            parameters=[parameters("controllers"), use_sim_time],
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            name="spawner",
            namespace=NAMESPACE,
            output="screen",
            arguments=[*CONTROLLERS, "--controller-manager", MANAGER],
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
