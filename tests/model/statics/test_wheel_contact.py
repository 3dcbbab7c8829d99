"""The statics agree with MuJoCo, although they do not import it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.backends.plans import ROBOTS, Plan, build, grafted, square
from thorvaldc.model import Robot
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.model.statics.mass_matrix import inverse_weights
from thorvaldc.model.statics.standing_pose import solve_statics
from thorvaldc.model.statics.wheel_contact import normal_force, penetration_under

Written = Callable[[Robot], Path]


def load(folder: Path) -> tuple[Any, Any]:
    m = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    return m, d


@pytest.mark.parametrize("seed", range(9))
def test_inverse_weights_are_those_of_mujoco(seed: int, written: Written) -> None:
    robot = replace(grafted(seed), namespace="")
    m, _ = load(written(robot))
    heavy = [link for link in robot.links if link.inertial is not None]
    weights, inertias = inverse_weights(
        JointTree(robot.links, robot.joints), robot.inertial.com, [link.name for link in heavy]
    )
    expected = [m.body_invweight0[m.body(link.name).id, 0] for link in heavy]
    assert weights == pytest.approx(expected, rel=1e-8)  # MuJoCo 3.14 differs by 1e-9
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    for joint in robot.joints:
        if joint.type != "fixed":
            dof = m.joint(joint.name).dofadr[0]
            assert inertias[joint.name] + joint.armature == pytest.approx(
                full_mass_matrix(m, d)[dof, dof], rel=1e-9
            )


def full_mass_matrix(m: Any, d: Any) -> Any:
    full = np.zeros((m.nv, m.nv))
    # The argument is the MjData in MuJoCo 4, and an array of it in MuJoCo 3.
    mujoco.mj_fullM(m, full, d.qM) if hasattr(d, "qM") else mujoco.mj_fullM(m, d, full)
    return full


@pytest.mark.parametrize("force", [1e-6, 0.1, 10.0, 480.0, 1e4, 1e6])
@pytest.mark.parametrize("weight", [1e-4, 0.03, 2.0])
def test_penetration_inverts_the_force(force: float, weight: float) -> None:
    assert normal_force(penetration_under(force, weight), weight) == pytest.approx(force)


def test_no_force_no_penetration() -> None:
    assert penetration_under(0.0, 0.03) == 0.0
    assert normal_force(-1e-3, 0.03) == 0.0


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_home_is_at_rest(name: str, written: Written) -> None:
    robot = ROBOTS[name]
    m, d = load(written(robot))
    start = d.qpos.copy()
    stance = solve_statics(robot)
    assert stance.settled
    mujoco.mj_forward(m, d)
    depths = {m.geom(max(c.geom)).name: -c.dist for c in d.contact}
    for wheel in robot.wheels:
        assert depths[f"{wheel.link}_tread"] == pytest.approx(
            stance.wheels[wheel.name].penetration, abs=1e-7
        )
    for _ in range(200):  # one second
        mujoco.mj_step(m, d)
        assert np.abs(d.qpos[:7] - start[:7]).max() < 1e-6
    for joint, position in stance.positions.items():
        assert d.joint(joint).qpos[0] == pytest.approx(position, abs=1e-4)
    force, total = np.zeros(6), 0.0
    for i in range(d.ncon):
        mujoco.mj_contactForce(m, d, i, force)
        total += force[0]
    assert total == pytest.approx(robot.inertial.mass * 9.81, rel=1e-5)


def test_loads_of_a_suspended_robot_are_the_static_ones() -> None:
    robot = ROBOTS["suspended"]
    stance = solve_statics(robot)
    for wheel in robot.wheels:
        assert stance.wheels[wheel.name].force == pytest.approx(wheel.load, rel=1e-3)
        assert abs(stance.positions[str(wheel.suspension_joint)]) < 1e-4


def test_a_lifted_wheel_carries_nothing() -> None:
    # The middle wheel ends 5 cm above the ground; the four others carry the robot.
    robot = build([*square(), Plan(0.0, 0.5, radius=0.15)])
    lifted = [
        replace(j, pose=replace(j.pose, xyz=(0.0, 0.0, -0.45))) if j.name == "w4_axle" else j
        for j in robot.joints
    ]
    stance = solve_statics(replace(robot, joints=tuple(lifted)))
    assert stance.settled
    assert stance.wheels["w4"].penetration == 0.0
    assert sum(w.force for w in stance.wheels.values()) == pytest.approx(
        robot.inertial.mass * 9.81, rel=1e-9
    )


def test_a_robot_that_tips_over_stays_in_the_pose_of_its_file() -> None:
    robot = build([Plan(0.0, 0.4, "fixed"), Plan(0.0, -0.4, "fixed")], body_com=(0.2, 0.0, 0.0))
    stance = solve_statics(robot)
    assert not stance.settled
    assert stance.base.xyz == (0.0, 0.0, 0.0)
    assert all(math.isfinite(w.radius) and w.radius > 0.0 for w in stance.wheels.values())


def test_home_respects_limits(written: Written) -> None:
    robot = ROBOTS["square"]
    joints = [replace(j, lower=0.25) if j.name == "w0_turn" else j for j in robot.joints]
    robot = replace(robot, joints=tuple(joints))
    m, d = load(written(robot))
    assert d.joint("w0_turn").qpos[0] == 0.25
    assert d.ctrl[m.actuator("w0_steering").id] == 0.25
