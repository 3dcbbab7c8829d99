"""Wind-up of the drive servos: robots at a wall, on a slope, and on the simulated bus."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compiler.extras.arms import ARM, arm_robot
from tests.examples import example_robot
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.bus.simulated_motors import BaseMotors
from thorvaldc.simulation.physics.drive_servos import DriveServos
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

mujoco = pytest.importorskip("mujoco")
ROBOT = example_robot("4wd4ws_wide")
FILES = emit(ROBOT, ["mjcf"])
RADIUS = ROBOT.wheels[0].radius
N = len(ROBOT.wheels)
WALL = 1.5  # m, x of a wall at the height of the frame
DRIVES = [a for a in ROBOT.actuators if a.role == "propulsion"]


def wall(spec: Any) -> None:
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="wall", type=box, size=[0.1, 5, 1], pos=[WALL + 0.1, 0, 1.5])


def ramp(time: float, stop: float) -> float:
    """Wheel speed (rad/s) of a robot that starts at 0 s and stops from 0.8 m/s at ``stop`` s."""
    speed = min(0.8, time) if time < stop else max(0.0, 0.8 - (time - stop))
    return speed / RADIUS


def torques(scene: MujocoScene) -> np.ndarray:
    indices = [scene.index("actuator", a.name, ROBOT) for a in DRIVES]
    return np.abs(scene.data.actuator_force[indices])


def drive(base: MujocoBase, start: float, end: float, stop: float = 5.0) -> None:
    for k in range(round(start * 100), round(end * 100)):
        base.read(k * 0.01)
        base.write(JointCommands([ramp(k * 0.01, stop)] * N, [0.0] * N), k * 0.01)


def test_push_at_a_wall_ends_with_the_stop() -> None:
    scene = MujocoScene(FILES, prepare=wall)
    base = MujocoBase(ROBOT, scene)
    drive(base, 0.0, 5.0)
    full = DRIVES[0].max_torque
    assert torques(scene).max() == pytest.approx(full, rel=1e-6)  # the robot is stalled
    drive(base, 5.0, 5.8 + 0.4)
    assert torques(scene).max() < 0.1 * full
    drive(base, 6.2, 12.0)
    assert torques(scene).max() < 0.1 * full


def test_blocked_wheel_does_not_catch_up() -> None:
    scene = MujocoScene(FILES, prepare=wall)
    base = MujocoBase(ROBOT, scene)
    drive(base, 0.0, 5.0, stop=100.0)
    index = scene.index("geom", "wall", ROBOT)
    scene.model.geom_contype[index] = scene.model.geom_conaffinity[index] = 0
    fastest = 0.0
    for k in range(500, 700):
        drive(base, k * 0.01, (k + 1) * 0.01, stop=100.0)
        fastest = max(fastest, base.true_twist().vx)
    assert fastest < 1.0  # m/s; without a limit, the robot accelerates to its top speed
    assert base.true_twist().vx == pytest.approx(0.8, rel=1e-3)


@pytest.mark.parametrize("angle", [10.0, -10.0, 15.0])
def test_robot_holds_on_a_slope_after_a_stop(angle: float) -> None:
    scene = MujocoScene(FILES)
    base = MujocoBase(ROBOT, scene)
    angle = math.radians(angle)
    scene.model.opt.gravity[:] = (-9.81 * math.sin(angle), 0.0, -9.81 * math.cos(angle))
    drive(base, 0.0, 3.8, stop=3.0)
    stopped = base.true_pose().x
    drive(base, 3.8, 4.8, stop=3.0)
    held = base.true_pose().x
    assert abs(stopped - held) < 0.003
    drive(base, 4.8, 9.8, stop=3.0)
    assert abs(base.true_pose().x - held) / 5.0 < 1.2e-4  # m/s


def test_motors_of_the_simulated_bus_stop_pushing() -> None:
    scene = MujocoScene(FILES, prepare=wall)
    motors = BaseMotors(ROBOT, MujocoBase(ROBOT, scene))
    drives = [motor for a in DRIVES if (motor := motors.motor(a)) is not None]
    for k in range(620):
        for motor in drives:
            motor.read(k * 0.01)
            motor.turn(ramp(k * 0.01, 5.0), k * 0.01)
        if k == 500:
            assert torques(scene).max() == pytest.approx(DRIVES[0].max_torque, rel=1e-6)
    assert torques(scene).max() < 0.1 * DRIVES[0].max_torque


def test_scene_without_the_base_driver() -> None:
    scene = MujocoScene(FILES, prepare=wall)
    model, data = scene.model, scene.data
    servos = DriveServos(model, data)
    indices = [scene.index("actuator", a.name, ROBOT) for a in DRIVES]
    for k in range(1600):
        data.ctrl[indices] = ramp(k * 0.005, 5.0) if k < 1240 else 0.0
        mujoco.mj_step(model, data)
        servos.limit()
    assert torques(scene).max() < 0.1 * DRIVES[0].max_torque


def test_servos_of_an_arm_are_no_drives(tmp_path: Path) -> None:
    """With an arm whose joints are commanded by their speeds, the drives behave as without it."""
    arm = ARM.replace(
        '<command_interface name="position"/>', '<command_interface name="velocity"/>'
    )
    robot = compile_file(arm_robot(tmp_path, arm=arm)).model
    assert isinstance(robot, Robot)
    scene = MujocoScene(emit(robot, ["mjcf"]), prepare=wall)
    drives = [
        scene.index("actuator", a.name, robot) for a in robot.actuators if a.role == "propulsion"
    ]
    all_servos = {i for i in range(scene.model.nu) if scene.model.actuator_actadr[i] >= 0}
    assert len(all_servos) == len(drives) + 4
    chosen = DriveServos(scene.model, scene.data, drives)
    by_default = DriveServos(scene.model, scene.data)
    data = scene.data
    data.qpos[:], data.qvel[:] = 50.0, 0.0
    for k, command in enumerate((1.0, 0.0, 0.0), start=1):
        data.time = k * 0.01
        data.ctrl[list(all_servos)] = command
        results = []
        for servos in (chosen, by_default):
            data.act[:] = 1e3
            servos.limit()
            results.append(data.act.tolist())
        assert results[0] == results[1] != [1e3] * scene.model.na


def test_reset_forgets_the_last_command() -> None:
    scene = MujocoScene(FILES)
    base = MujocoBase(ROBOT, scene)
    ends = []
    for _ in range(2):
        drive(base, 0.0, 0.5)
        ends.append(scene.data.qpos.copy())
        scene.reset()
        base.read(0.0)
        base.write(JointCommands([0.0] * N, [0.0] * N), 0.0)
    assert (ends[0] == ends[1]).all()
