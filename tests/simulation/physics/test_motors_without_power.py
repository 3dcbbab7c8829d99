"""A robot whose motors lose their power, on level ground and on slopes."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import pytest

from tests.examples import example_robot
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Brake, Robot
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.slope import coasting_deceleration, standing_slopes
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.sim_base import RollingBase, SimBase

ROBOT = example_robot("4wd4ws_wide")
FILES = emit(ROBOT, ["mjcf"])
N = len(ROBOT.wheels)
SPEED = 0.8 / ROBOT.wheels[0].radius  # rad/s


def with_motors(back_driving: float = 0.0, brake: Brake | None = None) -> Robot:
    return replace(
        ROBOT,
        actuators=tuple(
            replace(a, back_driving_torque=back_driving, brake=brake) for a in ROBOT.actuators
        ),
    )


def on_slope(robot: Robot, degrees: float) -> MujocoBase:
    """Returns the robot at rest, held by its drives, facing uphill."""
    pytest.importorskip("mujoco")
    scene = MujocoScene(FILES)
    angle = math.radians(degrees)
    scene.model.opt.gravity[:] = (-9.81 * math.sin(angle), 0.0, -9.81 * math.cos(angle))
    base = MujocoBase(robot, scene)
    base.read(2.0)
    return base


def switch(base: MujocoBase | SimBase, on: bool, now: float) -> None:
    """Switches the drives; the steering motors hold the wheels straight."""
    for i in range(N):
        base.switch_motor(i, False, on, now)


def path(base: MujocoBase, seconds: float, start: float = 2.0) -> float:
    before = base.true_pose().x
    base.read(start + seconds)
    return abs(base.true_pose().x - before)


def test_without_torque_a_robot_rolls_down_a_slope() -> None:
    base = on_slope(with_motors(), 6.0)
    assert path(base, 1.0) < 0.002
    switch(base, False, 3.0)
    # g (sin a - c cos a) t^2 / 2 less the inertia of wheels and rotors
    assert 4.0 < path(base, 5.0, 3.0) < 0.5 * 9.81 * (math.sin(math.radians(6.0))) * 25


def test_a_robot_stands_up_to_the_slope_of_its_statics() -> None:
    robot = with_motors(4.0)
    slopes = standing_slopes(robot)
    assert slopes is not None
    limit = math.degrees(slopes.motors_off)
    for degrees, rolls in ((0.8 * limit, False), (1.25 * limit, True)):
        base = on_slope(robot, degrees)
        switch(base, False, 2.0)
        assert (path(base, 5.0) > 0.2) is rolls


def test_the_mjcf_alone_rolls_where_the_robot_stands() -> None:
    """docs/mjcf.md: without actuation, MuJoCo has no back-driving torque."""
    robot = with_motors(4.0)
    slopes = standing_slopes(robot)
    assert slopes is not None
    base = on_slope(robot, 0.8 * math.degrees(slopes.motors_off))
    assert path(base, 2.0) < 0.01
    base.scene.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    assert path(base, 5.0, 2.0) > 0.2


def test_a_brake_holds_the_robot_when_it_has_closed() -> None:
    base = on_slope(with_motors(brake=Brake(84.0, 0.1)), 15.0)
    switch(base, False, 2.0)
    assert 0.003 < path(base, 0.1) < 0.03  # g sin(a) t^2 / 2 is 13 mm
    assert path(base, 0.2, 2.1) < 0.03
    assert path(base, 5.0, 2.3) < 0.02


def test_power_that_comes_back_holds_the_present_position() -> None:
    base = on_slope(with_motors(2.0), 10.0)
    friction = base.scene.model.dof_frictionloss.copy()
    switch(base, False, 2.0)
    assert path(base, 1.0) > 0.3
    switch(base, True, 3.0)
    path(base, 1.0, 3.0)
    assert path(base, 1.0, 4.0) < 0.005
    assert (base.scene.model.dof_frictionloss == friction).all(), "as in the MJCF file"


@pytest.mark.parametrize("kind", [SimBase, RollingBase])
def test_ideal_wheels_roll_out_with_their_friction(kind: type[SimBase]) -> None:
    base = kind(ROBOT)
    for k in range(100):
        base.read(k * 0.02)
        base.write(JointCommands([SPEED] * N, [0.0] * N), k * 0.02)
    switch(base, False, 2.0)
    wheel = ROBOT.wheels[0]
    motor = ROBOT.actuator_of(wheel.spin_joint)
    assert motor is not None
    deceleration = coasting_deceleration(wheel, ROBOT.joint(wheel.spin_joint), motor)
    assert 0.02 * GRAVITY < deceleration < 0.6
    for k in range(100, 126):
        states = base.read(k * 0.02)
    assert states.speeds[0] * wheel.radius == pytest.approx(0.8 - 0.5 * deceleration, abs=0.02)
    for k in range(126, 400):
        states = base.read(k * 0.02)
    assert max(map(abs, states.speeds)) < 1e-6


@pytest.mark.parametrize("kind", [SimBase, RollingBase])
def test_the_other_wheels_stop_a_wheel_without_power(kind: type[SimBase]) -> None:
    base = kind(ROBOT)
    for k in range(100):
        base.read(k * 0.02)
        base.write(JointCommands([SPEED] * N, [0.0] * N), k * 0.02)
    base.switch_motor(0, False, False, 2.0)
    base.write(JointCommands([0.0] * N, [0.0] * N), 2.0)
    for k in range(101, 150):
        states = base.read(k * 0.02)
    assert max(map(abs, states.speeds)) < 0.02 * SPEED


def test_a_robot_on_the_bus_rolls_when_its_power_is_cut() -> None:
    """Its devices hold it on the slope until then."""
    base = on_slope(with_motors(2.0), 6.0)
    simulated = SimulatedRobot(with_motors(2.0), base=base)
    simulated.power_on()
    simulated.run(4.0)
    base.read(4.0)
    before = base.true_pose().x
    simulated.run(1.0)
    base.read(5.0)
    held = abs(base.true_pose().x - before)
    simulated.power_off()
    simulated.run(3.0)
    base.read(8.0)
    assert held < 0.01 < 1.0 < abs(base.true_pose().x - before)
