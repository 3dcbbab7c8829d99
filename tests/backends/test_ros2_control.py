"""``<ros2_control>`` elements and controllers: names, types, and the robots that they can drive."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml

from tests.backends.conftest import write
from tests.backends.plans import Plan, build
from tests.backends.rcl_parameters import read
from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.robots import SPAN
from tests.simulation.bus.robots import cia402_robot, uneven_robot
from thorvaldc.backends.description_parts import mesh_files
from thorvaldc.backends.mjcf import ros2_control_files
from thorvaldc.backends.ros2 import gz_bridge
from thorvaldc.backends.ros2_control import PLUGINS, SIMULATED, hardware_problem
from thorvaldc.backends.ros2_controllers import (
    ackermann_problem,
    controller_parameters,
    controllers,
    diff_drive_problem,
    swerve_problem,
)
from thorvaldc.backends.ros2_parameters import parameter_file
from thorvaldc.backends.ros2_parts import CLOCK_TOPIC, bridged_topics
from thorvaldc.backends.sdf import model_text
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import JointServo, Robot
from thorvaldc.model.joint_topics import topic_of

# Parameters that a controller has in each distribution, with this name and type: ros2_controllers
# 4.x (jazzy), 5.x (kilted) and 6.x (lyrical), read on 2026-08-18 from the parameter files of the
# branches jazzy, kilted and master; the swerve controller from pull request 1694.
LIMITS = (
    *("max_velocity", "min_velocity", "max_acceleration", "max_deceleration"),
    *("max_acceleration_reverse", "max_deceleration_reverse", "max_jerk", "min_jerk"),
)
COMMON: dict[str, dict[Any, str]] = {
    "joint_state_broadcaster": {bool: "use_local_topics"},
    "diff_drive_controller": {
        list[str]: "left_wheel_names right_wheel_names",
        float: "wheel_separation wheel_radius wheel_separation_multiplier cmd_vel_timeout "
        "left_wheel_radius_multiplier right_wheel_radius_multiplier "
        + " ".join(f"{axis}.{limit}" for axis in ("linear.x", "angular.z") for limit in LIMITS),
        bool: "tf_frame_prefix_enable open_loop position_feedback enable_odom_tf "
        "publish_limited_velocity",
        str: "tf_frame_prefix odom_frame_id base_frame_id",
        list[float]: "pose_covariance_diagonal twist_covariance_diagonal",
        int: "velocity_rolling_window_size",
    },
    "ackermann_steering_controller": {
        float: "reference_timeout steering_track_width traction_track_width wheelbase "
        "traction_wheels_radius",
        list[str]: "traction_joints_names steering_joints_names traction_joints_state_names "
        "steering_joints_state_names",
        bool: "open_loop reduce_wheel_speed_until_steering_reached enable_odom_tf "
        "position_feedback",
        int: "velocity_rolling_window_size",
        str: "base_frame_id odom_frame_id",
        list[float]: "twist_covariance_diagonal pose_covariance_diagonal",
    },
    "forward_command_controller": {list[str]: "joints", str: "interface_name"},
    "joint_trajectory_controller": {
        list[str]: "joints command_joints command_interfaces state_interfaces"
    },
    "swerve_drive_controller": {
        str: "front_left_wheel_joint front_right_wheel_joint rear_left_wheel_joint "
        "rear_right_wheel_joint front_left_axle_joint front_right_axle_joint "
        "rear_left_axle_joint rear_right_axle_joint odom base_footprint",
        float: "wheelbase trackwidth wheel_radius cmd_vel_timeout front_left_velocity_threshold "
        "front_right_velocity_threshold rear_left_velocity_threshold "
        "rear_right_velocity_threshold",
        list[float]: "offset center_of_rotation pose_covariance_diagonal twist_covariance_diagonal",
        bool: "enable_odom_tf open_loop",
    },
}
TYPES = {
    package: {name: kind for kind, names in by_type.items() for name in names.split()}
    for package, by_type in COMMON.items()
}
# Plug-in classes that every distribution has; the last one is that of the pull request.
CLASSES = {
    "joint_state_broadcaster/JointStateBroadcaster",
    "diff_drive_controller/DiffDriveController",
    "ackermann_steering_controller/AckermannSteeringController",
    "forward_command_controller/ForwardCommandController",
    "joint_trajectory_controller/JointTrajectoryController",
    "swerve_drive_controller/SwerveController",
}

FOUR = [Plan(x, y) for x in (0.6, -0.6) for y in (0.5, -0.5)]
TWO_AND_CASTERS = [
    *(Plan(0.3, y, "fixed") for y in (0.4, -0.4)),
    *(Plan(-0.4, y, "swivel", radius=0.1, trail=-0.05) for y in (0.3, -0.3)),
]


def car() -> Robot:
    """A robot with a driven rear axle and a steered front axle without drives."""
    front = [Plan(0.7, y) for y in (0.45, -0.45)]
    robot = build([*front, *(Plan(-0.5, y, "fixed") for y in (0.5, -0.5))])
    idle = {wheel.spin_joint for wheel in robot.wheels if wheel.steered}
    return replace(
        robot,
        wheels=tuple(replace(w, driven=not w.steered) for w in robot.wheels),
        actuators=tuple(a for a in robot.actuators if a.joint not in idle),
    )


def with_arm(robot: Robot) -> Robot:
    """The robot with servos on two of its passive joints, as those of an arm would have."""
    actuated = {actuator.joint for actuator in robot.actuators}
    free = [j for j in robot.joints if j.type == "continuous" and j.name not in actuated][:2]
    kinds = ("position", "velocity")
    servos = [JointServo(j.name, kind, 0.0, SPAN) for j, kind in zip(free, kinds, strict=True)]
    return replace(robot, joint_servos=tuple(servos))


ROBOTS = {
    "differential": build(TWO_AND_CASTERS),
    "skidding": build([Plan(x, y, "fixed") for x in (0.6, -0.6) for y in (0.5, -0.5)]),
    "rear drive": car(),
    "corners": build(FOUR),
    "six": build([*FOUR, Plan(0.0, 0.5), Plan(0.0, -0.5)]),
    "arm": with_arm(build(TWO_AND_CASTERS)),
    "named": replace(build(TWO_AND_CASTERS), namespace="r7"),
}


def every_robot() -> dict[str, Robot]:
    robots = ROBOTS | {name: example_robot(name) for name in SAMPLED_ROBOTS}
    for fleet in FLEETS:
        robots |= {f"{fleet}-{p.name}": p.robot for p in example_fleet(fleet).placements}
    return robots


def parameters_of(robot: Robot) -> dict[str, dict[str, Any]]:
    """The parameters as rcl reads them."""
    (nodes,) = controller_parameters(robot).values()
    return {node.removeprefix("/"): values for node, values in read(parameter_file(nodes)).items()}


def type_of(value: Any) -> Any:
    return list[type(value[0])] if isinstance(value, list) else type(value)  # type: ignore[misc]


def test_every_parameter_of_a_controller_exists_with_its_type() -> None:
    used = set()
    for name, robot in every_robot().items():
        parameters = parameters_of(robot)
        manager = parameters.pop(f"{robot.prefix}controller_manager")
        assert isinstance(manager.pop("update_rate"), int)
        assert manager == {f"{c.name}.type": c.type for c in controllers(robot)}
        for controller in controllers(robot):
            assert controller.type in CLASSES
            values = parameters.pop(robot.prefix + controller.name, {})
            for key, value in values.items():
                expected = TYPES[controller.package][key]
                assert expected == type_of(value), (name, controller.name, key)
            used.add(controller.type)
        assert parameters == {}
    assert used == CLASSES


def interfaces(robot: Robot, hardware: str) -> dict[str, dict[str, tuple[str, ...]]]:
    """The command and state interfaces of each joint in the URDF."""
    root = ElementTree.fromstring(urdf_text(robot, hardware=hardware, share="/share"))
    urdf = {joint.get("name") for joint in root.findall("joint") if joint.get("type") != "fixed"}
    found = {}
    for joint in root.findall("ros2_control/joint"):
        assert joint.get("name") in urdf
        found[str(joint.get("name"))] = {
            tag: tuple(str(e.get("name")) for e in joint.findall(f"{tag}_interface"))
            for tag in ("command", "state")
        }
    return found


def test_controllers_use_only_interfaces_of_the_hardware() -> None:
    for name, robot in every_robot().items():
        for hardware in SIMULATED:
            joints = interfaces(robot, hardware)
            moving = {robot.prefix + j.name for j in robot.joints if j.type != "fixed"}
            assert joints.keys() == moving
            claimed = claims(robot)
            assert {joint: joints[joint]["command"] for joint in claimed} == claimed, name
            driven = {a.joint for a in robot.actuators} | {s.joint for s in robot.joint_servos}
            assert claimed.keys() == {robot.prefix + joint for joint in driven}
            assert all(j["state"] == ("position", "velocity") for j in joints.values())


def claims(robot: Robot) -> dict[str, tuple[str, ...]]:
    """The command interface of each joint that the released controllers need."""
    claimed: dict[str, tuple[str, ...]] = {}
    for controller in controllers(robot):
        values: Mapping[str, Any] = controller.parameters
        kinds = {
            "left_wheel_names": "velocity",
            "right_wheel_names": "velocity",
            "traction_joints_names": "velocity",
            "steering_joints_names": "position",
            "joints": values.get("interface_name", "position"),
        }
        if controller.is_released:
            for key, kind in kinds.items():
                for joint in values.get(key, ()):
                    assert joint not in claimed
                    claimed[joint] = (kind,)
    return claimed


def base_of(robot: Robot) -> list[str]:
    return [c.package for c in controllers(robot) if c.package != "joint_state_broadcaster"]


FORWARD = "forward_command_controller"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("differential", ["diff_drive_controller"]),
        ("skidding", ["diff_drive_controller"]),
        ("rear drive", ["ackermann_steering_controller"]),
        ("corners", [FORWARD, FORWARD, "swerve_drive_controller"]),
        ("six", [FORWARD, FORWARD]),
        ("arm", ["diff_drive_controller", "joint_trajectory_controller", FORWARD]),
    ],
)
def test_controller_of_the_base(name: str, expected: list[str]) -> None:
    assert base_of(ROBOTS[name]) == expected
    assert [c.is_released for c in controllers(ROBOTS[name])].count(False) == (name == "corners")


def test_geometry_of_the_controllers() -> None:
    values = parameters_of(ROBOTS["differential"])["diff_drive_controller"]
    assert (values["wheel_separation"], values["wheel_radius"]) == (0.8, 0.2)
    values = parameters_of(ROBOTS["rear drive"])["ackermann_steering_controller"]
    assert values["wheelbase"] == pytest.approx(1.2)
    assert values["steering_track_width"] == pytest.approx(0.9)
    assert values["traction_track_width"] == pytest.approx(1.0)
    wheels = {wheel.spin_joint: wheel for wheel in ROBOTS["rear drive"].wheels}
    assert [wheels[joint].y < 0.0 for joint in values["traction_joints_names"]] == [True, False]
    notes = {c.name: c.note for c in controllers(ROBOTS["differential"])}
    assert "x = 0.3 m" in notes["diff_drive_controller"]
    notes = {c.name: c.note for c in controllers(ROBOTS["skidding"])}
    assert "skidding" in notes["diff_drive_controller"]


def test_frames_and_nodes_have_the_name_space() -> None:
    values = parameters_of(ROBOTS["named"])["r7/diff_drive_controller"]
    assert (values["odom_frame_id"], values["base_frame_id"]) == ("r7/odom", "r7/base_link")
    assert all(joint.startswith("r7/") for joint in values["left_wheel_names"])


@pytest.mark.parametrize(
    ("plans", "problem", "reason"),
    [
        ([Plan(0.3, 0.4, "fixed"), Plan(0.3, -0.5, "fixed")], diff_drive_problem, "distances"),
        ([*TWO_AND_CASTERS, Plan(0.3, 0.6, "fixed")], diff_drive_problem, "2 driven wheels on"),
        ([Plan(0.3, y, "fixed", heading=0.1) for y in (0.4, -0.4)], diff_drive_problem, "forward"),
        (FOUR, diff_drive_problem, "steered"),
        (FOUR, ackermann_problem, "no command to the drives"),
        ([*FOUR[:3], Plan(-0.7, -0.5)], swerve_problem, "rectangle"),
        ([Plan(p.x, p.y, trail=0.05) for p in FOUR], swerve_problem, "beside the steering"),
    ],
)
def test_reason_against_a_controller(plans: list[Plan], problem: Any, reason: str) -> None:
    if len(plans) == 2:
        plans = [*plans, Plan(-0.4, 0.0, "swivel", radius=0.1, trail=-0.05)]
    assert reason in str(problem(build(plans)))


@pytest.mark.parametrize(
    ("name", "problem", "wheel", "values", "reason"),
    [
        # 0.8 mm, 0.8 mrad and 1.8 % are tolerances of a calibration; half as much again is not.
        ("skidding", diff_drive_problem, 0, {"y": 0.5012}, "distances"),
        ("skidding", diff_drive_problem, 0, {"heading": 0.0012}, "forward"),
        ("skidding", diff_drive_problem, 0, {"radius": 0.2 / (1 - 0.024)}, "different radii"),
        ("skidding", diff_drive_problem, 1, {"radius": 0.2 * (1 - 0.024)}, "different radii"),
        ("rear drive", ackermann_problem, 0, {"x": 0.7012}, "steered wheels are not symm"),
        ("rear drive", ackermann_problem, 2, {"y": 0.5012}, "driven wheels are not symm"),
        ("rear drive", ackermann_problem, 1, {"trail": 0.0012}, "beside the steering axes"),
        ("rear drive", ackermann_problem, 1, {"lateral_offset": -0.0012}, "beside the steering"),
        ("rear drive", ackermann_problem, 3, {"heading": math.tau - 0.0012}, "forward"),
        ("rear drive", ackermann_problem, 2, {"radius": 0.2 * (1 - 0.024)}, "different radii"),
        ("corners", swerve_problem, 3, {"x": -0.6012}, "rectangle"),
        ("corners", swerve_problem, 3, {"y": -0.4988}, "rectangle"),
        ("corners", swerve_problem, 2, {"heading": -0.0012}, "forward"),
        ("corners", swerve_problem, 2, {"trail": -0.0012}, "beside the steering axes"),
        ("corners", swerve_problem, 2, {"radius": 0.2 * (1 - 0.024)}, "different radii"),
    ],
)
def test_tolerances_of_the_controllers(
    name: str, problem: Any, wheel: int, values: dict[str, float], reason: str
) -> None:
    def with_change(share: float) -> Robot:
        wheels = list(ROBOTS[name].wheels)
        before = wheels[wheel]
        between = {
            key: (1.0 - share) * math.remainder(getattr(before, key), math.tau)
            + share * math.remainder(value, math.tau)
            for key, value in values.items()
        }
        wheels[wheel] = replace(before, **between)
        return replace(ROBOTS[name], wheels=tuple(wheels))

    assert problem(with_change(0.0)) is None
    assert problem(with_change(0.8 / 1.2)) is None
    assert reason in str(problem(with_change(1.0)))


# -- hardware ---------------------------------------------------------------------------


@pytest.mark.parametrize("hardware", SIMULATED)
def test_check_urdf_accepts_every_hardware(hardware: str, tmp_path: Path, check_urdf: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_text(ROBOTS["arm"], hardware=hardware, share="/share"))
    process = subprocess.run([check_urdf, str(path)], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr


def test_ranges_of_the_commands() -> None:
    robot = ROBOTS["corners"]
    root = ElementTree.fromstring(urdf_text(robot, hardware="mock"))
    for actuator in robot.actuators:
        joint = robot.joint(actuator.joint)
        path = f"ros2_control/joint[@name='{joint.name}']/command_interface/param"
        low, high = (float(param.text or "") for param in root.findall(path))
        if actuator.role == "propulsion":
            assert (low, high) == (-actuator.max_velocity, actuator.max_velocity)
        else:
            assert (low, high) == (joint.lower, joint.upper)


def test_each_drive_on_the_bus_has_its_node_and_axis() -> None:
    for robot in (cia402_robot(), uneven_robot()):
        problem = hardware_problem(robot, "can")
        if problem is not None:
            assert "no CiA 402 drive" in problem
            continue
        root = ElementTree.fromstring(urdf_text(robot, hardware="can", share="/share"))
        (system,) = root.findall("ros2_control")
        assert system.findtext("hardware/plugin") == PLUGINS["can"]
        params = {p.get("name"): p.text for p in system.findall("hardware/param")}
        assert params["bus_config"] == "/share/can/bus.yml"
        for actuator in robot.actuators:
            (joint,) = system.findall(f"joint[@name='{actuator.joint}']")
            values = {p.get("name"): int(p.text or "") for p in joint.findall("param")}
            (node,) = (n for n in robot.buses[0].nodes if n.name == actuator.node)
            assert values["node_id"] == node.id
            assert node.channels[values.get("channel", 0)].name == actuator.channel
    assert hardware_problem(cia402_robot(), "can") is None


def test_a_robot_without_cia402_drives_has_no_can_hardware() -> None:
    robot = example_robot("4wd4ws_wide")
    problem = hardware_problem(robot, "can")
    assert problem is not None
    assert "no CiA 402 drive moves fl_steering_steering" in problem
    assert hardware_problem(ROBOTS["corners"], "can") == "the robot has no CAN bus"


EXTENSION = (
    '<ros2_control name="arm" type="system"><hardware><plugin>real/Arm</plugin></hardware>'
    '<joint name="wheel_0"/></ros2_control>'
)


def test_simulated_hardware_replaces_that_of_an_extra() -> None:
    robot = replace(cia402_robot(), urdf_extensions=(EXTENSION,))
    for hardware, kept in ((None, True), ("mock", False), ("gazebo", False), ("can", True)):
        assert ("real/Arm" in urdf_text(robot, hardware=hardware)) == kept


# -- MuJoCo -----------------------------------------------------------------------------


def load_scene(robot: Robot, folder: Path) -> Any:
    write({**ros2_control_files(robot), **mesh_files(robot)}, folder)
    return mujoco.MjModel.from_xml_path(str(folder / "mjcf/scene.xml"))


@pytest.mark.parametrize("name", ["arm", "corners", "named"])
def test_actuators_have_the_kind_of_their_interface(name: str, tmp_path: Path) -> None:
    """mujoco_ros2_control takes an actuator with a position gain for a position servo, and one with
    a velocity gain alone for a velocity servo."""
    robot = ROBOTS[name]
    model = load_scene(robot, tmp_path)
    joints = interfaces(robot, "mujoco")
    kinds = {}
    for i in range(model.nu):
        assert model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
        kind = "position" if model.actuator_biasprm[i, 1] else "velocity"
        kinds[model.joint(model.actuator_trnid[i, 0]).name] = (kind,)
    assert kinds == {joint: j["command"] for joint, j in joints.items() if j["command"]}
    assert model.key("home").id == 0


@pytest.mark.parametrize("name", ["1wd1ws_rear", "4wd4ws_wide"])
def test_robot_with_velocity_servos_drives_and_stands_on_a_slope(name: str, tmp_path: Path) -> None:
    robot = example_robot(name)
    model = load_scene(robot, tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    drives = [i for i, a in enumerate(robot.actuators) if a.role == "propulsion"]
    torques = []
    for step in range(500):
        data.ctrl[drives] = min(1.0, step / 100) * 4.0  # rad/s
        mujoco.mj_step(model, data)
        if 30 < step < 100:
            torques.append(float(data.actuator_force[drives[0]]))
    assert data.qvel[0] == pytest.approx(0.8, rel=2e-3)
    assert abs(data.qvel[5]) < 1e-3
    assert np.std(np.diff(torques)) < 5.0  # N m: the torque does not jump between its limits
    mujoco.mj_resetDataKeyframe(model, data, 0)
    angle = np.radians(10.0)
    model.opt.gravity[:] = (-9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle))
    for _ in range(400):
        mujoco.mj_step(model, data)
    assert abs(data.qvel[0]) < 8e-3


# -- Gazebo -----------------------------------------------------------------------------


def gazebo_topics(robot: Robot, share: str | None) -> set[str]:
    """The topics that the systems and sensors of the SDF model have."""
    root = ElementTree.fromstring(model_text(robot, share=share))
    topics = set()
    for plugin in root.iter("plugin"):
        topics |= {str(e.text) for e in plugin if e.tag in ("topic", "odom_topic")}
    for sensor in root.iter("sensor"):
        topic = str(sensor.findtext("topic"))
        name = str(sensor.get("name")).removeprefix(robot.prefix)
        has_points = any(s.name == name and s.type == "lidar_3d" for s in robot.sensors)
        topics.add(f"{topic}/points" if has_points else topic)
        topics |= {str(e.text) for e in sensor.findall("camera/camera_info_topic")}
    return topics


@pytest.mark.parametrize("share", [None, "/share"])
def test_the_bridge_connects_the_topics_of_the_model(share: str | None) -> None:
    for name, robot in every_robot().items():
        bridged = bridged_topics(robot, ros2_control=share is not None)
        assert {t.gazebo for t in bridged} == gazebo_topics(robot, share), name
        # The topic `joint_states` is that of the base driver in ROS.
        assert all(t.gazebo == robot.prefix + t.ros.removeprefix("engine/") for t in bridged)
        names = [t.ros for t in bridged]
        assert len(set(names)) == len(names)


def test_bridge_file_is_the_list_that_the_bridge_reads() -> None:
    robot = example_robot("4wd4ws_wide")
    entries = yaml.safe_load(gz_bridge([CLOCK_TOPIC, *bridged_topics(robot)]))
    keys = {"ros_topic_name", "gz_topic_name", "ros_type_name", "gz_type_name", "direction"}
    assert all(set(entry) == keys for entry in entries)
    assert entries[0]["gz_topic_name"] == "/clock"
    commands = [e for e in entries if e["direction"] == "ROS_TO_GZ"]
    assert len(commands) == len(robot.actuators)


@pytest.mark.parametrize(
    ("name", "topic"), [("a-b.c/cmd_pos", "a_b_c/cmd_pos"), ("//3rd finger", "_3rd_finger")]
)
def test_topics_have_only_characters_of_ros(name: str, topic: str) -> None:
    assert topic_of(name) == topic


def test_a_model_for_ros2_control_has_its_plugin() -> None:
    root = ElementTree.fromstring(model_text(ROBOTS["named"], share="$(find my_robot)"))
    plugins = {str(p.get("name")): p for p in root.iter("plugin")}
    assert set(plugins) == {
        "gz::sim::systems::OdometryPublisher",
        "gz_ros2_control::GazeboSimROS2ControlPlugin",
    }
    plugin = plugins["gz_ros2_control::GazeboSimROS2ControlPlugin"]
    assert plugin.findtext("parameters") == "$(find my_robot)/config/controllers.yaml"
    assert plugin.findtext("ros/namespace") == "/r7"
