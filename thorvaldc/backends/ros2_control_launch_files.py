"""The launch files in which controllers of ros2_control or of Gazebo move the joints.

A robot with a controller that computes its joints from a twist has the node twist_mux in front of
this controller, with the sources and locks of the base driver. The joints of other robots are moved
by topics of single joints.
"""

from __future__ import annotations

import json

from thorvaldc.backends.gazebo_topics import CLOCK_STEPS, GAZEBO_CLOCK, gz_bridge
from thorvaldc.backends.placeholders import fill
from thorvaldc.backends.ros2_control import hardware_problem
from thorvaldc.backends.ros2_controllers import (
    CONTROLLER_FILE,
    Controller,
    controller_parameters,
    controllers,
)
from thorvaldc.backends.ros2_parameter_file import parameter_file
from thorvaldc.backends.ros2_parameters import twist_mux
from thorvaldc.backends.ros2_parts import full_topic, node_space
from thorvaldc.backends.sdf import model_text, world_files
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import Robot

_SPAWN = """\
            Node(
                package="controller_manager",
                executable="spawner",
                name="spawner",
                namespace=NAMESPACE,
                output="screen",
                arguments=[*CONTROLLERS, "--controller-manager", "@MANAGER@"],
            ),
"""
_TWIST_MUX = """\
            Node(
                package="twist_mux",
                executable="twist_mux",
                name="twist_mux",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "twist_mux.yaml"), use_sim_time],
                remappings=[("cmd_vel_out", "@COMMAND@")],
            ),
"""
_STATE_PUBLISHER = """\
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
"""


def _outdented(text: str) -> str:
    return "".join(line[4:] for line in text.splitlines(keepends=True))


ROS2_CONTROL = (
    """\
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "hardware",
                default_value="mock",
                choices=["mock", "mujoco"],
                description="ideal joints, or joints in MuJoCo by mujoco_ros2_control",
            ),
            OpaqueFunction(function=start),
        ]
    )


def start(context):
    share = get_package_share_directory(PACKAGE)
    config = os.path.join(share, "config")
    hardware = LaunchConfiguration("hardware").perform(context)
    with open(os.path.join(share, "urdf", f"robot_{hardware}.urdf"), encoding="utf-8") as file:
        description = file.read().replace("$(find @PACKAGE@)", share)
    use_sim_time = {"use_sim_time": hardware == "mujoco"}
    package = "mujoco_ros2_control" if hardware == "mujoco" else "controller_manager"
    return [
"""
    + _outdented(
        _STATE_PUBLISHER
        + """\
            Node(
                package=package,
                executable="ros2_control_node",
                name="controller_manager",
                namespace=NAMESPACE,
                output="screen",
                parameters=[os.path.join(config, "controllers.yaml"), use_sim_time],
                remappings=[@ODOMETRY@],
            ),
"""
    )
    + """\
@OUTER_SPAWN@@OUTER_TWIST_MUX@    ]
"""
)

GAZEBO = (
    """\
    config = os.path.join(share, "config")
    with open(os.path.join(share, "urdf", "@URDF@"), encoding="utf-8") as file:
        description = file.read().replace("$(find @PACKAGE@)", share)
    with open(os.path.join(share, "sdf", "model.sdf"), encoding="utf-8") as file:
        model = file.read().replace("$(find @PACKAGE@)", share)
    use_sim_time = {"use_sim_time": True}
    gazebo = get_package_share_directory("ros_gz_sim")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "gz_args", default_value="-r", description="options of gz sim; -r -s: no window"
            ),
            # Gazebo finds the meshes of the package in this folder.
            AppendEnvironmentVariable("GZ_SIM_RESOURCE_PATH", os.path.dirname(share)),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(os.path.join(gazebo, "launch", "gz_sim.launch.py")),
                launch_arguments={
                    "gz_args": [
                        LaunchConfiguration("gz_args"),
                        " ",
                        os.path.join(share, "sdf", "world.sdf"),
                    ]
                }.items(),
            ),
            Node(
                package="ros_gz_sim",
                executable="create",
                name="create",
                namespace=NAMESPACE,
                output="screen",
                arguments=["-name", "@NAME@", "-string", model],
            ),
            Node(
                package="ros_gz_bridge",
                executable="parameter_bridge",
                name="gz_bridge",
                namespace=NAMESPACE,
                output="screen",
                parameters=[{"config_file": os.path.join(config, "gz_bridge.yaml")}, use_sim_time],
            ),
            # Gazebo sends the time at every step of the physics; the nodes get every @STEPS@th.
            Node(
                package="topic_tools",
                executable="drop",
                name="clock_drop",
                namespace=NAMESPACE,
                output="screen",
                parameters=[
                    {
                        "input_topic": "@GAZEBO_CLOCK@",
                        "output_topic": "/clock",
                        "X": @LEFT_OUT_STEPS@,
                        "Y": @STEPS@,
                    }
                ],
            ),
"""
    + _STATE_PUBLISHER
    + """\
@SPAWN@@TWIST_MUX@        ]
    )
"""
)


def twist_controller(robot: Robot) -> Controller | None:
    """Return the released controller that computes the joints of the robot from a twist."""
    for controller in controllers(robot):
        if controller.is_released and controller.odometry_topic:
            return controller
    return None


def control_values(robot: Robot) -> dict[str, str]:
    """Return the values for the placeholders of the launch files."""
    controller = twist_controller(robot)
    names = [c.name for c in controllers(robot) if c.is_released]
    odometry = ""
    if controller is not None:
        pair = (controller.odometry_topic, "odometry/base_raw")
        odometry = "({}, {})".format(*(json.dumps(full_topic(robot, topic)) for topic in pair))
    spawn = fill(_SPAWN, {"MANAGER": f"{node_space(robot)}controller_manager"})
    mux = ""
    if controller is not None:
        mux = fill(_TWIST_MUX, {"COMMAND": controller.command_topic})
    return {
        "CONTROLLERS": json.dumps(names, indent=4).replace('"\n]', '",\n]'),
        "OUTER_SPAWN": _outdented(spawn),
        "SPAWN": spawn if controller is not None else "",
        "TWIST_MUX": mux,
        "OUTER_TWIST_MUX": _outdented(mux),
        "ODOMETRY": odometry,
        "GAZEBO_CLOCK": GAZEBO_CLOCK,
        "LEFT_OUT_STEPS": str(CLOCK_STEPS - 1),
        "STEPS": str(CLOCK_STEPS),
        "URDF": "robot_gazebo.urdf" if controller is not None else "robot.urdf",
        "NAME": robot.namespace or robot.name,
    }


def control_packages(robot: Robot) -> set[str]:
    """Return the ROS packages with the plug-ins of the controllers and the hardware."""
    packages = {c.package for c in controllers(robot) if c.is_released}
    packages |= {"controller_manager", "mujoco_ros2_control"}
    return packages | ({"gz_ros2_control"} if twist_controller(robot) is not None else set())


def left_out_of_control(robot: Robot) -> list[tuple[str, str]]:
    """Return what ros2_control cannot do with the robot, and the reasons."""
    reasons = []
    if twist_controller(robot) is None:
        reasons.append(
            (
                "twists in ros2_control.launch.py and gazebo.launch.py",
                "no released controller computes the joints of this robot from a twist; topics of "
                "the joints move them",
            )
        )
    problem = hardware_problem(robot, "can")
    reasons.append(
        (
            "ros2_control on the CAN bus",
            problem
            or "the tool dcfgen of ros2_canopen makes the files of the master from can/bus.yml",
        )
    )
    return reasons


def control_files(robot: Robot) -> dict[str, bytes]:
    """Return the parameters, descriptions and models of ros2_control and Gazebo, by path."""
    package = robot.ros.package
    meshes, share = f"package://{package}/meshes", f"$(find {package})"
    is_driven = twist_controller(robot) is not None
    kinds = ["mock", "mujoco", *(["gazebo"] if is_driven else [])]
    files = {f"urdf/robot_{kind}.urdf": urdf_text(robot, meshes, kind, share) for kind in kinds}
    files["sdf/model.sdf"] = model_text(
        robot, f"model://{package}/meshes", share if is_driven else None
    )
    files["config/gz_bridge.yaml"] = gz_bridge(robot, ros2_control=is_driven)
    files[CONTROLLER_FILE] = parameter_file(controller_parameters(robot)[CONTROLLER_FILE])
    if is_driven:
        mux = {f"{node_space(robot)}twist_mux": twist_mux(robot)}
        files["config/twist_mux.yaml"] = parameter_file(mux)
    return {
        **{path: text.encode() for path, text in files.items()},
        **world_files(robot.name, [robot]),
    }
