"""SDF, URDF and MJCF of each example and fleet: one robot for libsdformat, Drake and MuJoCo."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from tests.backend_files import files_of
from tests.backends.conftest import write
from tests.backends.drake_jobs import read_by_drake, wheel_targets
from tests.examples import FLEETS, FOLDER, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.outside_tools import path_of_dart_python
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.backends.sdf import Sdf, model_text
from thorvaldc.backends.urdf import Urdf
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot

READER = Path(__file__).with_name("sdformat_reader.py")
SCENARIOS = ("field_edge", "greenhouse_rails")
NONE = 1e8  # a larger limit means no limit: URDF must state one


def read_by_sdformat(jobs: Sequence[tuple[str, Path]]) -> list[str]:
    process = subprocess.run(
        [sys.executable, str(READER)],
        input=json.dumps([(command, str(path)) for command, path in jobs]),
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    texts: list[str] = json.loads(process.stdout)
    return texts


def fleets() -> dict[str, Fleet]:
    found = {name: example_fleet(name) for name in FLEETS}
    for name in SCENARIOS:
        model = compile_file(FOLDER / "scenarios" / f"{name}.yaml").model
        assert isinstance(model, Fleet)
        found[name] = model
    return found


@pytest.mark.slow
def test_libsdformat_accepts_every_model_and_world(tmp_path: Path, ign: str) -> None:
    """A world contains the models of its robots; the models alone are those of three robots."""
    models: dict[str, Robot | Fleet] = {name: example_robot(name) for name in SAMPLED_ROBOTS}
    paths = []
    for name, model in (models | fleets()).items():
        folder = write(files_of(Sdf, model), tmp_path / name)
        paths.append(folder / "sdf/world.sdf")
        if name in SAMPLED_ROBOTS[:3]:
            paths += [folder / "sdf/model.sdf", folder / "sdf/ros2_control.sdf"]
            paths[-1].write_text(model_text(example_robot(name), share="/share"))
    texts = read_by_sdformat([("check", path) for path in paths])
    for path, text in zip(paths, texts, strict=True):
        assert text.splitlines()[-1:] == ["Valid."], (path, text)
        for uri in ElementTree.parse(path).iter("uri"):
            assert (path.parent / str(uri.text)).is_file()


# -- the URDF, as libsdformat reads it, against the SDF -------------------------------------


def numbers(text: str | None) -> list[float]:
    return [float(word) for word in (text or "").split()]


def matrix(pose: ElementTree.Element | None) -> Any:
    """The pose as a matrix of 4 x 4 numbers."""
    x, y, z, *rpy = numbers(pose.text) if pose is not None else [0.0] * 6
    result = np.eye(4)
    for axis, angle in zip((2, 1, 0), reversed(rpy), strict=True):
        quat, turn = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quat, np.eye(3)[axis], angle)
        mujoco.mju_quat2Mat(turn, quat)
        result[:3, :3] = result[:3, :3] @ turn.reshape(3, 3)
    result[:3, 3] = x, y, z
    return result


def links(model: ElementTree.Element) -> dict[str, tuple[float, Any, Any]]:
    """Mass, centre of mass, and inertia about it in the axes of the link, by the link's name."""
    found = {}
    for link in model.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        pose = matrix(inertial.find("pose"))
        xx, yy, zz, xy, xz, yz = (
            float(inertial.findtext(f"inertia/i{name}", "0"))
            for name in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        turn = pose[:3, :3]
        mass = float(inertial.findtext("mass", "nan"))
        found[str(link.get("name"))] = (mass, pose[:3, 3], turn @ tensor @ turn.T)
    return found


def joints(model: ElementTree.Element) -> dict[str, list[Any]]:
    """Type, ends, pose of the child in the parent, axis, limits, damping and spring of the moving
    joints."""
    poses = {
        str(e.get("name")): e.find("pose") for e in (*model.findall("link"), *model.iter("joint"))
    }
    found = {}
    for joint in model.findall("joint"):
        if joint.get("type") == "fixed":
            continue
        parent, child = str(joint.findtext("parent")), str(joint.findtext("child"))
        pose = poses[child]
        if pose is not None and pose.get("relative_to") == joint.get("name"):
            pose = poses[str(joint.get("name"))]
        assert pose is not None
        assert pose.get("relative_to") == parent
        axis = joint.find("axis")
        assert axis is not None
        limits = [float(axis.findtext(f"limit/{n}", "inf")) for n in ("lower", "upper", "velocity")]
        effort = float(axis.findtext("limit/effort", "inf"))
        limits.append(math.inf if effort < 0.0 else effort)
        spring = float(axis.findtext("dynamics/spring_stiffness", "0"))
        found[str(joint.get("name"))] = [
            [joint.get("type"), parent, child],
            matrix(pose),
            numbers(axis.findtext("xyz")),
            [min(max(limit, -NONE), NONE) for limit in limits],
            float(axis.findtext("dynamics/damping", "0")),
            spring,
            float(axis.findtext("dynamics/spring_reference", "0")) if spring else 0.0,
        ]
    return found


def differences(urdf: ElementTree.Element, sdf: ElementTree.Element) -> list[str]:
    found = []
    for what, one, two in (
        ("link", links(urdf), links(sdf)),
        ("joint", joints(urdf), joints(sdf)),
    ):
        if one.keys() != two.keys():
            found.append(f"{what}s: {sorted(one.keys() ^ two.keys())}")
        for name in one.keys() & two.keys():
            for a, b in zip(one[name], two[name], strict=True):
                if isinstance(a, list) and isinstance(a[0], str):
                    same = a == b
                else:
                    same = np.allclose(a, b, rtol=1e-9, atol=1e-9)
                if not same:
                    found.append(f"{what} {name}: {a} and {b}")
    return found


def model_of(text: str) -> ElementTree.Element:
    model = ElementTree.fromstring(text[text.index("<sdf") :]).find("model")
    assert model is not None
    return model


def every_robot() -> dict[str, Robot]:
    robots = {name: example_robot(name) for name in SAMPLED_ROBOTS}
    for fleet in FLEETS:
        robots |= {f"{fleet}-{p.name}": p.robot for p in example_fleet(fleet).placements}
    return robots


@pytest.mark.slow
def test_libsdformat_reads_the_same_robot_from_urdf_and_sdf(tmp_path: Path, ign: str) -> None:
    jobs = []
    for name, robot in every_robot().items():
        folder = write({**files_of(Urdf, robot), **files_of(Sdf, robot)}, tmp_path / name)
        jobs += [("print", folder / "urdf/robot.urdf"), ("print", folder / "sdf/model.sdf")]
    texts = read_by_sdformat(jobs)
    for name, urdf, sdf in zip(every_robot(), texts[::2], texts[1::2], strict=True):
        assert differences(model_of(urdf), model_of(sdf)) == [], name
    # The comparison notices a change of each value.
    model = model_of(texts[1])
    for path in ("mass", "ixx", "xyz", "upper", "effort", "pose", "damping"):
        changed = model_of(texts[1])
        elements = [e for e in changed.iter(path) if path != "pose" or e.get("relative_to")]
        element = next(e for e in elements if 0.0 < max(map(abs, numbers(e.text))) < NONE)
        element.text = " ".join(str(value * 1.001 + 0.001) for value in numbers(element.text))
        assert differences(model, changed), path


# -- worlds -----------------------------------------------------------------------------


@pytest.mark.slow
def test_every_robot_of_a_world_floats_at_its_place(tmp_path: Path) -> None:
    """In Drake the SDF world, in MuJoCo the scene: no robot is fixed to the ground."""
    jobs = []
    for name, fleet in fleets().items():
        folder = write({**files_of(Sdf, fleet), **files_of(Mjcf, fleet)}, tmp_path / name)
        jobs.append({"kind": "world", "sdf": str(folder / "sdf/world.sdf")})
    for (name, fleet), world in zip(fleets().items(), read_by_drake(jobs), strict=True):
        bases = {p.robot.prefix + p.robot.links[0].name: p.pose for p in fleet.placements}
        assert world["floating"].keys() == bases.keys(), name
        for base, pose in bases.items():
            assert world["floating"][base][:3] == pytest.approx(pose.xyz, abs=1e-9)
        robot_bodies = {
            p.robot.prefix + link.name for p in fleet.placements for link in p.robot.links
        }
        assert not robot_bodies & set(world["fixed"])
        total = math.fsum(p.robot.inertial.mass for p in fleet.placements)
        assert world["mass"] == pytest.approx(total, rel=1e-9)
        scene = mujoco.MjModel.from_xml_path(str(tmp_path / name / "mjcf/scene.xml"))
        data = mujoco.MjData(scene)
        mujoco.mj_kinematics(scene, data)
        free = [j for j in range(scene.njnt) if scene.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
        assert {scene.body(scene.jnt_bodyid[j]).name for j in free} == bases.keys()
        for base, pose in bases.items():
            assert data.body(base).xpos == pytest.approx(pose.xyz, abs=1e-9)
        assert scene.body_subtreemass[0] == pytest.approx(total, rel=1e-9)


# -- motion -----------------------------------------------------------------------------

SECONDS = 3.0
MOTIONS = {"straight": (0.8, 0.0, 0.0), "sideways": (0.0, 0.5, 0.0), "spot turn": (0.0, 0.0, 0.6)}
RAMP = 0.5  # s


def driven_in_mujoco(scene: Path, wheels: Sequence[dict[str, Any]]) -> tuple[Any, float]:
    """How far the robot comes after the ramp, and how far it turns; in the frame of its base."""
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    by_joint = {model.joint(model.actuator_trnid[i, 0]).name: i for i in range(model.nu)}
    for wheel in wheels:
        if wheel["steering"]:
            data.joint(wheel["steering"]).qpos[0] = wheel["angle"]
            data.ctrl[by_joint[wheel["steering"]]] = wheel["angle"]

    def step(share: float) -> None:
        for wheel in wheels:
            data.ctrl[by_joint[wheel["drive"]]] = share * wheel["speed"]
        mujoco.mj_step(model, data)

    count = round(RAMP / model.opt.timestep)
    for i in range(count):
        step((i + 1) / count)
    for _ in range(count):  # until the servos have their speed
        step(1.0)
    start, turned, before = data.qpos[:7].copy(), 0.0, heading(data.qpos[3:7])
    for _ in range(round(SECONDS / model.opt.timestep)):
        step(1.0)
        now = heading(data.qpos[3:7])
        turned += math.remainder(now - before, math.tau)
        before = now
    inverse, move = np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(inverse, start[3:7])
    mujoco.mju_rotVecQuat(move, data.qpos[:3] - start[:3], inverse)
    return move, turned


def heading(quat: Any) -> float:
    w, x, y, z = quat
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@pytest.mark.slow
def test_drake_and_mujoco_drive_as_computed(tmp_path: Path) -> None:
    """Drake drives the SDF and MuJoCo the MJCF through the same motions: both agree with the
    closed form to 0.5 %."""
    robot = example_robot("4wd4ws_wide")
    folder = write({**files_of(Sdf, robot), **files_of(Mjcf, robot)}, tmp_path)
    targets = {name: wheel_targets(robot, twist) for name, twist in MOTIONS.items()}
    sdf = str(folder / "sdf/model.sdf")
    jobs = [
        {"kind": "drive", "sdf": sdf, "wheels": wheels, "seconds": SECONDS}
        for wheels in targets.values()
    ]
    for (name, (vx, vy, wz)), motion in zip(MOTIONS.items(), read_by_drake(jobs), strict=True):
        move, yaw = driven_in_mujoco(folder / "mjcf/scene.xml", targets[name])
        distance, angle = math.hypot(vx, vy) * SECONDS, wz * SECONDS
        for x, y, turned in ((*motion["move"][:2], motion["yaw"]), (*move[:2], yaw)):
            assert math.hypot(x, y) == pytest.approx(distance, rel=5e-3, abs=0.01), name
            assert turned == pytest.approx(angle, rel=5e-3, abs=0.005), name
            if distance:
                assert math.atan2(y, x) == pytest.approx(math.atan2(vy, vx), abs=5e-3)
        assert motion["height"] == pytest.approx(0.0, abs=0.005), name


@pytest.mark.slow
def test_spheres_roll_as_computed_in_the_engine_of_gazebo(tmp_path: Path) -> None:
    """On the tyres of the SDF, a robot turns on the spot as computed; on cylinders it does not."""
    robot = example_robot("4wd4ws_wide")
    folder = write({**files_of(Urdf, robot), **files_of(Sdf, robot)}, tmp_path)
    root = ElementTree.parse(folder / "sdf/model.sdf").getroot()
    spheres = {}
    for wheel in robot.wheels:
        (tyre,) = root.iterfind(f".//collision[@name='{wheel.link}_collision_0']")
        spheres[wheel.link] = float(tyre.findtext("geometry/sphere/radius") or "nan")
    springs = {j.name: (j.stiffness, j.spring_reference) for j in robot.joints if j.stiffness}
    seconds = 1.5
    job = {"urdf": str(folder / "urdf/robot.urdf"), "springs": springs, "seconds": seconds}
    turn, straight = (wheel_targets(robot, MOTIONS[name]) for name in ("spot turn", "straight"))
    turned, rolled, on_cylinders = read_by_dart(
        [
            job | {"wheels": turn, "spheres": spheres},
            job | {"wheels": straight, "spheres": spheres},
            job | {"wheels": turn, "spheres": {}},
        ]
    )
    assert turned == [
        pytest.approx(MOTIONS["spot turn"][2] * seconds, rel=1e-3),
        pytest.approx(0.0, abs=1e-3),
    ]
    assert rolled == [pytest.approx(0.0, abs=1e-3), pytest.approx(0.8 * seconds, rel=1e-3)]
    assert abs(on_cylinders[0] / turned[0] - 1.0) > 0.05


def read_by_dart(jobs: Sequence[dict[str, Any]]) -> list[Any]:
    process = subprocess.run(
        [path_of_dart_python(), str(READER.with_name("dart_reader.py"))],
        input=json.dumps(jobs),
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    results: list[Any] = json.loads(process.stdout)
    return results
