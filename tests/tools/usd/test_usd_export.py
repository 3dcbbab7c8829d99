"""The OpenUSD file of each example, read by OpenUSD without the converter, against the model."""

from __future__ import annotations

import json
import math
import re
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.conftest import Command
from tests.examples import SAMPLED_ROBOTS
from tests.outside_tools import path_of_usd_python
from tests.slow import mostly_slow
from thorvaldc.backends.description_parts import mesh_files
from thorvaldc.backends.mjcf import ros2_control_files
from thorvaldc.compiler.pipeline import load
from thorvaldc.model import Robot
from thorvaldc.model.spatial import quat_to_matrix
from thorvaldc.model.statics.joint_tree import tree_of

ROOT = Path(__file__).resolve().parents[3]
READER = Path(__file__).with_name("usd_reader.py")
WIDE = "4wd4ws_wide"
# In one process: the converter writes each robot once.
pytestmark = pytest.mark.xdist_group("usd")
RULES = {"RigidBodyChecker", "ColliderChecker", "ArticulationChecker", "PhysicsJointChecker"}


def write(name: str, output: Path) -> str:
    """Runs the command in the environment of the converter, and returns its messages."""
    result = subprocess.run(
        [
            *(path_of_usd_python(converter=True), "-m", "thorvaldc", "usd"),
            *(f"examples/{name}/robot.yaml", "-o", str(output)),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return result.stderr


@cache
def read(name: str) -> tuple[Robot, dict[str, Any], str]:
    """Returns the model, what OpenUSD reads from its file, and the messages of the command."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.usda")
        messages = write(name, path)
        result = subprocess.run(
            [path_of_usd_python(converter=False), "-W", "ignore", str(READER), str(path)],
            capture_output=True,
            text=True,
        )
    assert result.returncode == 0, result.stderr
    robot = load(ROOT / f"examples/{name}/robot.yaml")
    assert isinstance(robot, Robot)
    return robot, json.loads(result.stdout)[0], messages


def pose_matrix(pose: Any) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(quat_to_matrix(pose.quat)).reshape(3, 3)
    matrix[:3, 3] = pose.xyz
    return matrix


def shifted(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Returns the inertia about the origin (parallel-axis theorem)."""
    return inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_openusd_accepts_the_file(name: str) -> None:
    robot, usd, _ = read(name)
    assert {validator.rpartition(":")[2] for validator in usd["validators"]} >= RULES
    assert usd["errors"] == []
    assert (usd["up_axis"], usd["metres"], usd["files"]) == ("Z", 1.0, 1)
    assert usd["roots"] == [robot.links[0].name]
    assert usd["nested"] == []
    moving = [joint for joint in robot.joints if joint.type != "fixed"]
    prismatic = sum(joint.type == "prismatic" for joint in moving)
    parsed = usd["parsed"]
    assert (parsed["Articulation"], parsed["Scene"], parsed["CollisionGroup"]) == (1, 1, 1)
    assert parsed["RigidBody"] == len(moving) + 1
    assert parsed.get("RevoluteJoint", 0) == len(moving) - prismatic
    assert parsed.get("PrismaticJoint", 0) == prismatic
    assert "FixedJoint" not in parsed


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_links_have_the_poses_of_the_model(name: str) -> None:
    robot, usd, _ = read(name)
    tree = tree_of(robot)
    for link, pose in tree.pose.items():
        assert np.array(usd["frames"][link]) == pytest.approx(pose_matrix(pose), abs=1e-6), link


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_bodies_have_mass_and_inertia_of_their_links(name: str) -> None:
    robot, usd, _ = read(name)
    tree = tree_of(robot)
    sums: dict[str, tuple[float, np.ndarray, np.ndarray]] = {}
    for link in tree.order:
        root = link
        while root in tree.parent_joint and tree.parent_joint[root].type == "fixed":
            root = tree.parent_joint[root].parent
        inertial = tree.links[link].inertial
        mass, moment, inertia = sums.get(root, (0.0, np.zeros(3), np.zeros((3, 3))))
        if inertial is not None:
            pose = pose_matrix(tree.pose[link])
            com = pose[:3, :3] @ inertial.com + pose[:3, 3]
            xx, yy, zz, xy, xz, yz = inertial.inertia
            local = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            turned = pose[:3, :3] @ local @ pose[:3, :3].T
            mass += inertial.mass
            moment = moment + inertial.mass * com
            inertia = inertia + shifted(inertial.mass, com, turned)
        sums[root] = (mass, moment, inertia)
    assert set(usd["bodies"]) == set(sums)
    for root, (mass, moment, inertia) in sums.items():
        body = usd["bodies"][root]
        pose = np.array(body["pose"])
        com = pose[:3, :3] @ body["com"] + pose[:3, 3]
        turned = pose[:3, :3] @ np.array(body["inertia"]) @ pose[:3, :3].T
        assert body["mass"] == pytest.approx(mass, rel=1e-6), root
        assert com * mass == pytest.approx(moment, abs=1e-5 * mass), root
        expected = pytest.approx(inertia, abs=1e-5 * np.trace(inertia))
        assert shifted(body["mass"], com, turned) == expected, root
    total = sum(body["mass"] for body in usd["bodies"].values())
    assert total == pytest.approx(robot.inertial.mass, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_joints_have_the_axes_and_limits_of_the_model(name: str) -> None:
    robot, usd, _ = read(name)
    tree = tree_of(robot)
    moving = {joint.name: joint for joint in robot.joints if joint.type != "fixed"}
    assert set(usd["joints"]) == set(moving)
    for joint_name, joint in moving.items():
        read_joint = usd["joints"][joint_name]
        pose = pose_matrix(tree.pose[joint.child])
        column = "XYZ".index(read_joint["axis"])
        first, second = (np.array(side["pose"]) for side in read_joint["sides"])
        assert first == pytest.approx(second, abs=1e-5), joint_name
        assert second[:3, 3] == pytest.approx(pose[:3, 3], abs=1e-6)
        assert second[:3, column] == pytest.approx(pose[:3, :3] @ joint.axis, abs=1e-6)
        lower = -math.inf if joint.lower is None else joint.lower
        upper = math.inf if joint.upper is None else joint.upper
        assert (read_joint["lower"], read_joint["upper"]) == pytest.approx((lower, upper), rel=1e-6)
        assert read_joint["sides"][1]["body"] == joint.child
        if joint.velocity is not None:
            assert read_joint["max_speed"] == pytest.approx(joint.velocity, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_drives_have_the_gains_of_motors_and_springs(name: str, tmp_path: Path) -> None:
    """The gains of motors are those that MuJoCo computes from the MJCF with `velocity` servos."""
    import mujoco

    robot, usd, _ = read(name)
    for path, data in (ros2_control_files(robot) | mesh_files(robot)).items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(data)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "mjcf/robot.xml"))
    drives = {joint: value["drive"] for joint, value in usd["joints"].items() if "drive" in value}
    motors = {actuator.joint: actuator for actuator in robot.actuators}
    motors |= {servo.joint: servo for servo in robot.joint_servos}
    assert model.nu == len(motors)
    for number in range(model.nu):
        joint = model.joint(int(model.actuator_trnid[number, 0])).name
        drive = drives.pop(joint)
        _, stiffness, damping = -model.actuator_biasprm[number, :3]
        assert drive["stiffness"] == pytest.approx(stiffness, rel=1e-5, abs=1e-9), joint
        assert drive["damping"] == pytest.approx(damping, rel=1e-5), joint
        assert drive["speed"] == 0.0
        if joint in {actuator.joint for actuator in robot.actuators}:
            assert drive["force"] == pytest.approx(motors[joint].max_torque, rel=1e-6)
            is_steering = motors[joint].role == "steering"
            assert (drive["stiffness"] > 0.0) == is_steering
    passive = {
        joint.name: joint
        for joint in robot.joints
        if joint.name not in motors and (joint.stiffness > 0.0 or joint.damping > 0.0)
    }
    assert set(drives) == set(passive)
    for name_, joint in passive.items():
        drive = drives[name_]
        assert drive["stiffness"] == pytest.approx(joint.stiffness, rel=1e-6), name_
        assert drive["damping"] == pytest.approx(joint.damping, rel=1e-6), name_
        assert drive["force"] == math.inf
        if joint.stiffness:
            assert drive["target"] == pytest.approx(joint.spring_reference, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_every_contact_of_the_mjcf_is_a_collision(name: str) -> None:
    robot, usd, _ = read(name)
    text = ros2_control_files(robot)["mjcf/robot.xml"].decode()
    geoms = re.findall(r'<geom [^>]*class="(?:collision|wheel)"', text)
    assert len(usd["collisions"]) == len(geoms)
    tree = tree_of(robot)
    spheres = [c for c in usd["collisions"].values() if c["type"] == "Sphere"]
    for wheel in robot.wheels:
        center = tree.pose[wheel.link].xyz
        nearest = min(spheres, key=lambda c: math.dist(c["center"], center))
        assert math.dist(nearest["center"], center) < 1e-6
        # A rigid engine rolls on it, without the enlargement of soft contacts.
        assert nearest["radius"] == pytest.approx(wheel.radius, abs=1e-6)


@pytest.mark.slow
def test_the_robot_of_four_steered_wheels_has_12_joints_and_12_drives() -> None:
    robot, usd, messages = read(WIDE)
    assert len(usd["joints"]) == 12
    assert len(usd["bodies"]) == 13
    assert sum("drive" in joint for joint in usd["joints"].values()) == 12
    assert sum(body["mass"] for body in usd["bodies"].values()) == pytest.approx(190.62, abs=0.01)
    names = ", ".join(sensor.name for sensor in robot.sensors)
    assert f"TV617] usd-left-out: the USD file has only the frames of the sensors {names}" in (
        messages
    )


@pytest.mark.slow
def test_couplings_are_reported() -> None:
    _, _, messages = read("rocker_bogie")
    assert "couples the joints rocker_right_pivot by attributes of Newton" in messages


@pytest.mark.parametrize("suffix", mostly_slow(["usda", "usdc"], quick=0, slow=1))
def test_equal_robots_give_equal_bytes(suffix: str, tmp_path: Path) -> None:
    contents = []
    for number in range(2):
        write(WIDE, tmp_path / f"{number}.{suffix}")
        contents.append((tmp_path / f"{number}.{suffix}").read_bytes())
    assert contents[0] == contents[1]
    assert str(tmp_path).encode() not in contents[0]
    assert b"thorvaldc-usd-" not in contents[0]


@pytest.mark.parametrize("output", ["robot.usdz", "robot.xml", "no/robot.usda"])
def test_an_output_that_cannot_be_written_is_an_error(thorvaldc: Command, output: str) -> None:
    result = thorvaldc("usd", str(ROOT / "examples/lss/robot.yaml"), "-o", output)
    assert result.status == (3 if "/" in output else 2)


def test_a_fleet_is_not_one_robot(thorvaldc: Command) -> None:
    fleet = ROOT / "examples/fleet_of_four/fleet.yaml"
    result = thorvaldc("usd", str(fleet), "-o", "fleet.usda")
    assert result.status == 2
    assert "name one of its robots" in result.err


def test_errors_of_the_robot_are_reported_before_the_conversion(thorvaldc: Command) -> None:
    Path("bad.yaml").write_text("thorvaldc: 1\nname: r\nmodules: {frame: {type: frame/no}}\n")
    result = thorvaldc("usd", "bad.yaml", "-o", "bad.usda")
    assert result.status == 1
    assert not Path("bad.usda").exists()
