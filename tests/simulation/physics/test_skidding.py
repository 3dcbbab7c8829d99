"""Skid steering under Coulomb friction, compared with the closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.backend_files import files_of
from tests.robots import make_robot
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

pytest.importorskip("mujoco")
X, Y = 0.5, 0.4  # m
CORNERS = [(x, y, "fixed") for x in (X, -X) for y in (Y, -Y)]


@pytest.mark.parametrize("rate", [0.1, 1.0])
def test_a_turn_of_four_fixed_wheels_has_the_closed_form_rate(rate: float) -> None:
    """wz = 2 W v / (W^2 + L^2), with track W, wheelbase L and surface speed v of the wheels."""
    robot = make_robot(CORNERS)
    motors = tuple(replace(a, max_velocity=50.0, max_torque=200.0) for a in robot.actuators)
    robot = replace(robot, actuators=motors)
    scene = MujocoScene(files_of(Mjcf, robot))
    base = MujocoBase(robot, scene)
    v = rate * (X * X + Y * Y) / Y
    for wheel in robot.wheels:
        actuator = robot.actuator_of(wheel.spin_joint)
        assert actuator is not None
        number = scene.index("actuator", actuator.name, robot)
        scene.data.ctrl[number] = math.copysign(v, -wheel.y) / wheel.radius
    scene.advance(2.0)
    angle, last_yaw = 0.0, base.true_pose().yaw
    for k in range(200):
        scene.advance(2.0 + (k + 1) * 0.01)
        yaw = base.true_pose().yaw
        angle += math.remainder(yaw - last_yaw, math.tau)
        last_yaw = yaw
    assert angle / 2.0 == pytest.approx(rate, rel=0.005)


def test_robots_that_must_skid_use_implicit_integration() -> None:
    """Explicit integration is more exact for rolling, but sliding wheels chatter at 2 rad/s."""
    one_axle = [(0.0, Y, "fixed"), (0.0, -Y, "fixed"), (-X, 0.0, "swivel")]
    robots = [make_robot(wheels, body_mass=20.0) for wheels in (CORNERS, one_axle)]
    texts = [files_of(Mjcf, robot)["mjcf/robot.xml"] for robot in robots]
    assert [b'integrator="Euler"' in text for text in texts] == [False, True]
