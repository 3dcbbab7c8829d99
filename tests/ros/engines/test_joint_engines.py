"""The stand-ins for ros2_control and Isaac Sim move the joints of generated robots."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.backends.ros2.packages import write
from tests.examples import example_robot
from tests.ros.engines import running
from tests.ros.engines.test_gazebo import check
from tests.ros.environments import each_distro
from tests.ros.test_node import run_client
from thorvaldc.compiler.pipeline import emit

pytestmark = each_distro()
WHEELS = ("fl", "fr", "rl", "rr")
SPEEDS = {f"{wheel}_drive_axle": 3.0 + 0.1 * i for i, wheel in enumerate(WHEELS)}  # rad/s
ANGLES = {f"{wheel}_steering_joint": 0.05 * i for i, wheel in enumerate(WHEELS)}  # rad
FAST = ("--lockstep", "--factor", "0")


def build(folder: Path) -> Path:
    """Builds the package of a robot with four steered wheels, and returns its folder."""
    write(folder, emit(example_robot("4wd4ws_wide"), ["ros2", "mjcf"]))
    return running.named(folder / "ros2")


def arguments(package: Path, *options: str) -> list[str]:
    return ["-m", "tests.ros.engines.ros2_control_engine", str(package), *options]


def drive(
    distro: str, folder: Path, engine: Sequence[str], form: str, seconds: float
) -> dict[str, Any]:
    """Runs an engine and the client, and returns what the joints did and the engine's report."""
    with running.process(distro, folder, engine) as started:
        commands = json.dumps(SPEEDS), json.dumps(ANGLES)
        out = run_client(distro, "engines.joint_commands", folder, form, "", seconds, *commands)
        report = running.end(started)
    assert report["cycles"] > 0
    moved: dict[str, Any] = json.loads(out)
    return moved


def refusal(distro: str, folder: Path, engine: Sequence[str]) -> str:
    """Returns the only line of an engine that ends with exit status 1."""
    with running.process(distro, folder, engine) as started:
        _, err = started.communicate(timeout=300)
    assert started.returncode == 1, err
    (line,) = err.splitlines()
    return str(line)


def assert_moved(moved: dict[str, Any], tolerance: float) -> None:
    for joint, speed in SPEEDS.items():
        assert moved["velocity"][joint] == pytest.approx(speed, abs=tolerance), joint
        assert moved["position"][joint] > 1.0
    for joint, angle in ANGLES.items():
        assert moved["position"][joint] == pytest.approx(angle, abs=0.01), joint


@pytest.mark.slow
def test_mock_joints_follow_their_commands(distro: str, tmp_path: Path) -> None:
    moved = drive(distro, tmp_path, arguments(build(tmp_path)), "controllers", 1.0)
    assert_moved(moved, 1e-9)
    assert moved["names"] == sorted(moved["names"])


@pytest.mark.slow
def test_controllers_drive_a_robot_in_mujoco(distro: str, tmp_path: Path) -> None:
    package = build(tmp_path)
    for scene in (tmp_path / "mjcf", package / "mjcf"):
        engine = arguments(package, "--mujoco", str(scene / "scene.xml"), *FAST)
        moved = drive(distro, tmp_path, engine, "controllers", 2.0)
        assert_moved(moved, 0.4)
        assert moved["x"] > 0.5


@pytest.mark.slow
def test_joint_states_drive_a_robot_in_mujoco(distro: str, tmp_path: Path) -> None:
    scene = build(tmp_path).parent / "mjcf" / "scene.xml"
    topics = ["--speed-topic", "speed", "--angle-topic", "angle", "--state-topic", "states"]
    program = ["-m", "tests.ros.engines.joint_state_engine", "--scene", str(scene)]
    moved = drive(distro, tmp_path, [*program, *topics, *FAST], "joint_states", 2.0)
    assert_moved(moved, 0.4)
    assert moved["x"] > 0.5


@pytest.mark.slow
def test_another_order_of_joints_moves_other_joints(distro: str, tmp_path: Path) -> None:
    package = build(tmp_path)
    change(package, '"fl_drive_axle", "fr_drive_axle"', '"fr_drive_axle", "fl_drive_axle"')
    moved = drive(distro, tmp_path, arguments(package), "controllers", 1.0)
    assert moved["velocity"]["fl_drive_axle"] == SPEEDS["fr_drive_axle"]
    assert moved["velocity"]["fr_drive_axle"] == SPEEDS["fl_drive_axle"]


def change(package: Path, old: str, new: str, name: str = "config/controllers.yaml") -> None:
    path = package / name
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


CHANGES = {
    'interface_name: "velocity"': (
        'interface_name: "effort"',
        "drive_velocity_controller: the hardware has no interface fl_drive_axle/effort",
    ),
    "drive_velocity_controller:": (
        "drive_controller:",
        "the 'type' param was not defined for 'drive_velocity_controller'",
    ),
    "use_local_topics: true": (
        "local_topics: true",
        "joint_state_broadcaster: unknown parameter 'local_topics'",
    ),
    '["fl_drive_axle", "fr_drive_axle", "rl_drive_axle", "rr_drive_axle"]': (
        '["fl_axle"]',
        "drive_velocity_controller: the hardware has no interface fl_axle/velocity",
    ),
    "forward_command_controller/ForwardCommandController": (
        "velocity_controllers/Other",
        "controller 'drive_velocity_controller': unknown type 'velocity_controllers/Other'",
    ),
}


@pytest.mark.slow
def test_wrong_files_end_the_engine(distro: str, tmp_path: Path) -> None:
    path = build(tmp_path) / "config" / "controllers.yaml"
    text = path.read_text(encoding="utf-8")
    for old, (new, message) in CHANGES.items():
        change(tmp_path / "ros2", old, new)
        assert refusal(distro, tmp_path, arguments(tmp_path / "ros2")) == f"error: {message}"
        path.write_text(text, encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("dialect", ["ros2_control", "joint_states"])
def test_the_base_driver_knows_where_the_robot_is(
    distro: str, dialect: str, tmp_path: Path
) -> None:
    package, scene = build(tmp_path), str(tmp_path / "mjcf" / "scene.xml")
    engine = arguments(package, "--mujoco", scene, *FAST)
    if dialect == "joint_states":
        engine = ["-m", "tests.ros.engines.joint_state_engine", "--scene", scene, *FAST]
        for option, topic in (("speed", "speeds"), ("angle", "angles"), ("state", "states")):
            engine += [f"--{option}-topic", f"engine/joint_{topic}"]
    with (
        running.process(distro, tmp_path, engine) as started,
        running.node(distro, tmp_path, package, dialect=dialect),
    ):
        out = run_client(distro, "engines.mission", tmp_path, 12.0, "-")
        running.end(started)
    check(json.loads(out)["-"], 3.0)
