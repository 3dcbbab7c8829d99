"""The MuJoCo base with generated files."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import thorvaldc
from tests.backend_files import files_of
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Fleet, Placement, Pose, Robot
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

pytest.importorskip("mujoco")
ROBOT = make_robot(FOUR_STEERED)
EXAMPLE = Path(__file__).parents[3] / "examples/4wd4ws_slim/robot.yaml"


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    return files_of(Mjcf, ROBOT)


def write(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def error_of(files: object, robot: Robot = ROBOT) -> str:
    with pytest.raises(DiagnosticError) as caught:
        MujocoBase(robot, MujocoScene(files))  # type: ignore[arg-type]
    assert caught.value.diagnostic.code.name == "simulation-scene"
    return caught.value.diagnostic.message


def test_files_from_memory_and_from_disk_give_equal_runs(
    files: dict[str, bytes], tmp_path: Path
) -> None:
    ends = []
    for source in (files, write(tmp_path, files)):
        base = MujocoBase(ROBOT, MujocoScene(source))
        base.read(0.0)
        base.write(JointCommands([2.0, 2.5] * 2, [0.1] * 4), 0.0)
        for k in range(1, 30):
            states = base.read(k * 0.02)
        ends.append((base.true_pose(), list(states.positions or ())))
    assert ends[0] == ends[1]


def test_an_example_in_memory_is_the_model_on_disk(tmp_path: Path) -> None:
    """A scene with meshes and includes, and a fleet whose robots have files of equal names."""
    robot = thorvaldc.load(EXAMPLE)
    one, two = (replace(model, namespace=n) for model, n in ((robot, "one"), (ROBOT, "two")))
    placements = (Placement("one", Pose(), one), Placement("two", Pose((0.0, 3.0, 0.0)), two))
    fleet = Fleet("pair", "", placements)
    for name, model in (("robot", robot), ("fleet", fleet)):
        files = thorvaldc.emit(model, ["mjcf"])
        pair = [MujocoScene(source).model for source in (files, write(tmp_path / name, files))]
        assert saved(pair[0]) == saved(pair[1])


def test_meshes_of_equal_names_in_two_folders_stay_apart() -> None:
    emitted = thorvaldc.emit(thorvaldc.load(EXAMPLE), ["mjcf"])
    first, second, *_ = (data for name, data in emitted.items() if name.endswith(".stl"))
    scene = """<mujoco><asset><mesh name="a" file="../a/meshes/m.stl" inertia="shell"/>
        <mesh name="b" file="../b/meshes/m.stl" inertia="shell"/></asset><worldbody>
        <geom type="mesh" mesh="a"/><geom type="mesh" mesh="b"/></worldbody></mujoco>"""
    files = {"a/meshes/m.stl": first, "b/meshes/m.stl": second, "mjcf/scene.xml": scene.encode()}
    a, b = MujocoScene(files).model.mesh_vertnum
    assert a != b


def saved(model: Any) -> bytes:
    import mujoco
    import numpy

    buffer = numpy.zeros(mujoco.mj_sizeModel(model), numpy.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def test_robot_stands_still_in_its_home_pose(files: dict[str, bytes]) -> None:
    base = MujocoBase(ROBOT, MujocoScene(files))
    start = base.true_pose()
    base.read(2.0)
    assert base.scene.time == pytest.approx(2.0)
    assert math.dist(base.true_pose(), start) < 1e-6
    assert base.uprightness() == pytest.approx(1.0, abs=1e-6)


def test_true_twist_is_the_derivative_of_the_pose(files: dict[str, bytes]) -> None:
    base = MujocoBase(ROBOT, MujocoScene(files))
    turn = 0.4
    for k in range(1, 150):
        base.read(k * 0.02)
        speeds = [3.0 * (0.8 if i % 2 == 0 else 1.2) for i in range(4)]
        base.write(JointCommands(speeds, [turn, turn, -turn, -turn]), k * 0.02)
    first = base.true_pose()
    base.read(base.scene.time + 0.005)
    motion = base.true_pose().relative_to(first)
    twist = base.true_twist()
    assert abs(twist.wz) > 0.2
    assert motion == pytest.approx(Twist(*twist).scaled(0.005), abs=2e-5)


def test_a_robot_of_another_build_is_an_error(files: dict[str, bytes]) -> None:
    joint = replace(ROBOT.wheels[0], spin_joint="w0_other")
    other = replace(ROBOT, wheels=(joint, *ROBOT.wheels[1:]))
    assert "no joint `w0_other`" in error_of(files, other)


def test_missing_and_broken_scenes_are_errors(files: dict[str, bytes], tmp_path: Path) -> None:
    assert "has no file mjcf/scene.xml" in error_of(tmp_path)
    assert "has no file mjcf/scene.xml" in error_of({})
    broken = {**files, "mjcf/robot.xml": b"<mujoco><worldbody></mujoco>"}
    message = error_of(broken)
    assert message.startswith("MuJoCo cannot read mjcf/scene.xml")
    assert "/tmp" not in message
    no_include = {"mjcf/scene.xml": files["mjcf/scene.xml"]}
    assert "robot.xml" in error_of(no_include)


def test_divergence_is_detected_and_leaves_no_log_file(
    files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    base = MujocoBase(ROBOT, MujocoScene(files))
    assert not base.scene.diverged
    base.scene.data.qvel[0] = 1e12
    base.read(1.0)
    assert base.scene.diverged
    assert not list(tmp_path.iterdir())


def pair() -> Fleet:
    one, two = (replace(ROBOT, name=n, namespace=n) for n in ("one", "two"))
    places = (
        Placement("one", Pose((0.0, 3.0, 0.0)), one),
        Placement("two", Pose((0.0, -3.0, 0.0)), two),
    )
    return Fleet("pair", "", places)


def test_two_robots_of_a_scene_move_independently() -> None:
    """Two robots with equal joint names in two name spaces; one drives, the other stands."""
    fleet = pair()
    one, two = (placement.robot for placement in fleet.placements)
    scene = MujocoScene(files_of(Mjcf, fleet))
    a, b = MujocoBase(one, scene), MujocoBase(two, scene)
    for k in range(100):
        a.read(k * 0.02)
        b.read(k * 0.02)
        a.write(JointCommands([3.0] * 4, [0.0] * 4), k * 0.02)
    assert scene.steps == 396
    assert a.true_pose() == pytest.approx((1.1, 3.0, 0.0), abs=0.2)
    assert b.true_pose() == pytest.approx((0.0, -3.0, 0.0), abs=1e-5)


def test_the_motion_is_that_with_a_search_for_islands(files: dict[str, bytes]) -> None:
    import mujoco

    island = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    states = []
    for searched in (False, True):
        scene = MujocoScene(files)
        assert scene.model.opt.disableflags & island
        if searched:
            scene.model.opt.disableflags &= ~island
        scene.data.ctrl[:4] = 3.0, 3.0, 2.0, -1.0
        scene.advance(3.0)
        states.append(scene.data.qpos.tolist())
    assert states[0] == states[1]
    assert not MujocoScene(files_of(Mjcf, pair())).model.opt.disableflags & island
