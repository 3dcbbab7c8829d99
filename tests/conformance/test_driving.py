"""The motion of every robot in MuJoCo agrees with the rolling of its wheels."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.backend_files import files_of
from tests.backends.conftest import write
from tests.backends.plans import ROBOTS as PLANNED
from tests.backends.plans import SAMPLED_PLANS
from tests.conformance.driving import can_steer, can_turn, drive
from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.slow import mostly_slow
from tests.workshop import Workshop
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.model import Robot

SAMPLE = [f"examples/{name}" for name in SAMPLED_ROBOTS]
SAMPLE += [f"planned/{name}" for name in SAMPLED_PLANS]
UPRIGHT = [
    name
    for name in SAMPLE
    # Arms tilt the steering axes; steering limits without 0 allow no straight run.
    if name not in ("planned/cambered", "planned/swing_arms", "planned/turned_home")
]


def robot_of(name: str) -> Robot:
    group, _, robot = name.partition("/")
    return example_robot(robot) if group == "examples" else PLANNED[robot]


def scene_of(robot: Robot, folder: Path) -> Path:
    return write(files_of(Mjcf, robot), folder) / "mjcf" / "scene.xml"


@pytest.mark.parametrize("name", UPRIGHT)
def test_straight_distance_agrees_with_the_wheels(name: str, tmp_path: Path) -> None:
    robot = robot_of(name)
    run = drive(scene_of(robot, tmp_path), robot, radius=None)
    assert run.distance > 1.5
    assert abs(run.distance / run.wheel_distance - 1.0) < 1e-4
    assert abs(run.turn) < 1e-3
    assert run.highest_jump < 1e-3


@pytest.mark.parametrize("radius", mostly_slow([0.5, 3.0]))
@pytest.mark.parametrize("name", SAMPLE)
def test_turning_agrees_with_the_wheels(name: str, radius: float, tmp_path: Path) -> None:
    robot = robot_of(name)
    if not can_turn(robot):
        pytest.skip("can turn only by skidding")
    if not can_steer(robot, radius):
        pytest.skip("the steering limits do not allow a circle of this radius")
    run = drive(scene_of(robot, tmp_path), robot, radius=radius)
    assert run.turn > 0.5
    assert abs(run.turn / run.wheel_turn - 1.0) < (5e-2 if name == "planned/swing_arms" else 1e-2)


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_examples_stand_still_and_hold_on_a_slope(name: str, tmp_path: Path) -> None:
    robot = example_robot(name)
    m = mujoco.MjModel.from_xml_path(str(scene_of(robot, tmp_path)))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    base = slice(0, 3)
    start = d.qpos[base].copy()
    for _ in range(200):
        mujoco.mj_step(m, d)
    assert np.abs(d.qpos[base] - start).max() < 1e-4
    # 10 degrees in the direction of travel, servos at zero speed.
    m.opt.gravity[:] = (-9.81 * np.sin(np.radians(10)), 0, -9.81 * np.cos(np.radians(10)))
    for _ in range(400):
        mujoco.mj_step(m, d)
    start = d.qpos[base].copy()
    for _ in range(400):
        mujoco.mj_step(m, d)
    assert np.linalg.norm(d.qpos[base] - start) / 2.0 < 1e-3  # m/s


ROCKER = """
    links:
      pin: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}]}
      arm:
        parts:
          - {shape: {box: [0.8, 0.05, 0.05]}, xyz: [0.1, 0, 0], mass: 5 kg, source: "chosen: round"}
    joints:
      pivot:
        {type: revolute, role: suspension, parent: pin, child: arm, axis: [0, 1, 0],
         lower: -20 deg, upper: 20 deg}
    mount: {kinds: [clamp], link: pin}
    ports:
      fore: {kind: clamp, link: arm, xyz: [0.4, 0, 0]}
      aft: {kind: clamp, link: arm, xyz: [-0.3, 0, 0]}
"""


@pytest.mark.parametrize("drop", [0.0, 0.0005])
def test_wheels_on_rockers_carry_the_loads_of_the_model(
    workshop: Workshop, tmp_path: Path, drop: float
) -> None:
    """Also if the rear ports are ``drop`` m lower: the rockers turn until all wheels carry."""
    workshop.module("t/rocker", ROCKER.replace("[-0.3, 0, 0]", f"[-0.3, 0, {-drop}]"))
    robot = workshop.robot(
        """
        body: {type: t/plate}
        fl: {type: t/leg, mount: {parent: body, xyz: [0.9, 0.4, 0]}}
        fr: {type: t/leg, mount: {parent: body, xyz: [0.9, -0.4, 0]}}
        left: {type: t/rocker, mount: {parent: body, xyz: [-0.4, 0.5, 0]}}
        lf: {type: t/leg, mount: left.fore}
        la: {type: t/leg, mount: left.aft}
        right: {type: t/rocker, mount: {parent: body, xyz: [-0.4, -0.5, 0]}}
        rf: {type: t/leg, mount: right.fore}
        ra: {type: t/leg, mount: right.aft}
        """
    )
    m = mujoco.MjModel.from_xml_path(str(scene_of(robot, tmp_path)))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    start = d.qpos.copy()
    for _ in range(200):
        mujoco.mj_step(m, d)
    assert np.abs(d.qpos - start).max() < 1e-6
    force, carried = np.zeros(6), dict.fromkeys((w.link for w in robot.wheels), 0.0)
    for i in range(d.ncon):
        mujoco.mj_contactForce(m, d, i, force)
        carried[m.body(m.geom_bodyid[max(d.contact[i].geom)]).name] += force[0]
    for wheel in robot.wheels:
        assert carried[wheel.link] == pytest.approx(wheel.load, rel=1e-3)
    assert robot.wheels[3].load > 1.1 * robot.wheels[2].load


SWING_ARM = """
    links:
      pin: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}]}
      arm:
        parts:
          - {shape: {box: [0.4, 0.05, 0.05]}, xyz: [-0.2, 0, 0], mass: 4 kg,
             source: "chosen: round"}
    joints:
      swing:
        {type: revolute, role: suspension, parent: pin, child: arm, axis: [0, 1, 0],
         lower: -20 deg, upper: 20 deg, effort: 2 kN m, velocity: 1,
         spring: {stiffness: 2000 N m/rad, damping: 100 N m s/rad}}
    mount: {kinds: [clamp], link: pin}
    ports:
      hub: {kind: clamp, link: arm, xyz: [-0.4, 0, 0]}
"""


def test_springs_of_swing_arms_hold_the_robot_at_its_height(
    workshop: Workshop, tmp_path: Path
) -> None:
    workshop.module("t/swing_arm", SWING_ARM)
    robot = workshop.robot(
        """
        body: {type: t/plate}
        fl: {type: t/leg, mount: {parent: body, xyz: [0.9, 0.4, 0]}}
        fr: {type: t/leg, mount: {parent: body, xyz: [0.9, -0.4, 0]}}
        left: {type: t/swing_arm, mount: {parent: body, xyz: [-0.4, 0.5, 0]}}
        la: {type: t/leg, mount: left.hub}
        right: {type: t/swing_arm, mount: {parent: body, xyz: [-0.4, -0.5, 0]}}
        ra: {type: t/leg, mount: right.hub}
        """
    )
    m = mujoco.MjModel.from_xml_path(str(scene_of(robot, tmp_path)))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    start = d.qpos.copy()
    for _ in range(200):
        mujoco.mj_step(m, d)
    assert np.abs(d.qpos - start).max() < 1e-6
    for wheel in robot.wheels[2:]:
        # 1 mm: every wheel sinks into the ground by as much.
        assert d.joint(str(wheel.suspension_joint)).qpos[0] == pytest.approx(0.0, abs=1e-3)
        assert d.body(wheel.link).xpos[2] == pytest.approx(wheel.radius, abs=1e-3)


@pytest.mark.parametrize("name", FLEETS)
def test_fleets_stand_still(name: str, tmp_path: Path) -> None:
    write(files_of(Mjcf, example_fleet(name)), tmp_path)
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "mjcf" / "scene.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    start = d.qpos.copy()
    for _ in range(200):
        mujoco.mj_step(m, d)
    assert np.abs(d.qpos - start).max() < 1e-4
