"""Tests of the servos of extras: read from their files, and at work in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.compiler.extras.arms import ARM, arm_robot
from tests.compiler.extras.xacro_files import INERTIAL, Loaded, load_one
from thorvaldc import compile
from thorvaldc.backends.mjcf_robot import DEFLECTION
from thorvaldc.backends.sdf import model_text
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.compiler.pipeline import emit

POSITION = '<command_interface name="position"/>'
VELOCITY = '<command_interface name="velocity"/>'
EFFORT = '<command_interface name="effort"/>'


def load_joint(folder: Path, extension: str, kind: str = "revolute", more: str = "") -> Loaded:
    return load_one(
        folder,
        f'<link name="a">{INERTIAL}</link><joint name="j" type="{kind}">'
        f'<parent link="frame_body"/><child link="a"/>{more}'
        '<limit lower="0.5" upper="1" effort="10" velocity="2"/></joint>\n' + extension,
    )


def control(interfaces: str, initial: str | None = None, joint: str = "j") -> str:
    param = f'<param name="initial_value">{initial}</param>' if initial is not None else ""
    state = f'<state_interface name="position">{param}</state_interface>'
    return (
        '<ros2_control name="arm" type="system"><hardware><plugin>p</plugin></hardware>'
        f'<joint name="{joint}">{interfaces}{state}</joint></ros2_control>'
    )


def transmission(interface: str) -> str:
    stated = f"<hardwareInterface>hardware_interface/{interface}</hardwareInterface>"
    return f'<transmission name="t"><joint name="j">{stated}</joint></transmission>'


@pytest.mark.parametrize(
    ("extension", "interface", "initial"),
    [
        (control(POSITION + VELOCITY, "0.7"), "position", 0.7),
        (control(VELOCITY, "0.7"), "velocity", 0.7),
        (control(VELOCITY + EFFORT), "velocity", 0.5),
        (control(EFFORT), "position", 0.5),
        (control(POSITION, "nan"), "position", 0.5),
        (control(POSITION, "0.x"), "position", 0.5),
        (transmission("PositionJointInterface"), "position", 0.5),
        (transmission("VelocityJointInterface"), "velocity", 0.5),
        (transmission("EffortJointInterface"), "position", 0.5),
        (transmission("EffortJointInterface") + control(VELOCITY, "0.9"), "position", 0.9),
    ],
)
def test_a_driven_joint_has_a_servo(
    tmp_path: Path, extension: str, interface: str, initial: float
) -> None:
    loaded = load_joint(tmp_path, extension)
    assert loaded.codes == []
    (servo,) = loaded.parts.joint_servos
    assert (servo.joint, servo.interface, servo.initial) == ("j", interface, initial)
    assert servo.span.line == 4


@pytest.mark.parametrize("extension", [control(""), control(POSITION, joint="other"), "<gazebo/>"])
def test_other_joints_have_none(tmp_path: Path, extension: str) -> None:
    assert load_joint(tmp_path, extension).parts.joint_servos == ()


def test_fixed_and_mimic_joints_have_none(tmp_path: Path) -> None:
    assert load_joint(tmp_path, control(POSITION), "fixed").parts.joint_servos == ()
    mimic = '<mimic joint="frame_mount"/>'
    assert load_joint(tmp_path, control(POSITION), more=mimic).parts.joint_servos == ()


def test_an_initial_position_outside_of_the_limits(tmp_path: Path) -> None:
    loaded = load_joint(tmp_path, control(POSITION, "-3"))
    assert loaded.codes == ["extra-initial-position"]
    assert loaded.parts.joint_servos[0].initial == 0.5


@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_an_arm_holds_its_pose_under_gravity(tmp_path: Path, interface: str) -> None:
    """For 5 s, within the sag that the gains promise, and the robot stays where it stands."""
    mujoco = pytest.importorskip("mujoco")
    arm = ARM.replace('command_interface name="position"', f'command_interface name="{interface}"')
    compilation = compile(arm_robot(tmp_path, arm=arm))
    assert [d.code.name for d in compilation.report] == ["extra-inertia-computed"]
    robot = compilation.model
    for name, data in emit(robot, ["mjcf"]).items():
        path = tmp_path / "build" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "build/mjcf/scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = {"arm_shoulder": 0.3, "arm_elbow": 1.2, "arm_wrist": -0.5, "arm_finger": 0.4}
    assert {name: data.joint(name).qpos[0] for name in start} == pytest.approx(start)
    base = data.qpos[:3].copy()
    sag = dict.fromkeys(start, 0.0)
    while data.time < 5.0:
        mujoco.mj_step(model, data)
        for name in start:
            sag[name] = max(sag[name], abs(data.joint(name).qpos[0] - start[name]))
    # The weight needs less than half of each effort limit.
    assert max(sag[name] for name in ("arm_shoulder", "arm_elbow", "arm_wrist")) < DEFLECTION / 2
    assert sag["arm_shoulder"] > 1e-4  # it does hang on its servo
    assert sag["arm_finger"] < 0.02  # follows the other finger by a soft constraint of MuJoCo
    assert abs(data.qpos[:3] - base).max() < 1e-3
    assert abs(data.qvel).max() < 1e-3
    limits = model.actuator("arm_shoulder").forcerange
    assert tuple(limits) == (-150.0, 150.0)


def test_a_servo_moves_its_joint_to_a_set_point(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = compile(arm_robot(tmp_path)).model
    files = emit(robot, ["mjcf"])
    scene = {name.removeprefix("mjcf/"): data for name, data in files.items()}
    model = mujoco.MjModel.from_xml_string(scene["scene.xml"].decode(), scene)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.actuator("arm_elbow").ctrl[0] = 0.2
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    assert data.joint("arm_elbow").qpos[0] == pytest.approx(0.2, abs=DEFLECTION / 2)


def test_every_output_drives_the_joints_of_an_arm_as_stated(tmp_path: Path) -> None:
    """Gazebo and the simulated hardware of ros2_control: interface, start and limits of a joint."""
    robot = compile(arm_robot(tmp_path)).model
    stated = {"arm_shoulder": 0.3, "arm_elbow": 1.2, "arm_wrist": -0.5, "arm_knuckle": -0.4}
    model = ElementTree.fromstring(model_text(robot))
    controllers = {
        joint: plugin
        for plugin in model.iter("plugin")
        if plugin.get("name") == "gz::sim::systems::JointPositionController"
        and (joint := plugin.findtext("joint_name")) in stated
    }
    assert controllers.keys() == stated.keys()
    urdf = ElementTree.fromstring(urdf_text(robot, hardware="gazebo"))
    assert [e.get("name") for e in urdf.iter("ros2_control")] == ["robot_gazebo"]
    for name, initial in stated.items():
        joint = robot.joint(name)
        assert float(controllers[name].findtext("initial_position") or "0") == initial
        assert float(controllers[name].findtext("cmd_max") or "nan") == joint.velocity
        (element,) = urdf.findall(f"ros2_control/joint[@name='{name}']")
        values = [float(param.text or "") for param in element.iter("param")]
        assert values == [joint.lower, joint.upper, initial]
        assert [e.get("name") for e in element.findall("command_interface")] == ["position"]
    follower = urdf.find("ros2_control/joint[@name='arm_finger']")
    assert follower is not None
    assert follower.find("command_interface") is None
    # The hardware that the description names drives the arm of the real robot.
    plain = ElementTree.fromstring(urdf_text(robot))
    assert [e.get("name") for e in plain.iter("ros2_control")] == ["arm_control"]
