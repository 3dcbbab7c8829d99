"""Ideal ground against an independent integration of the rolling constraint."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.runtime.se2 import ORIGIN, Twist
from thorvaldc.simulation.control_loop import Segment
from thorvaldc.simulation.physics.sim_base import RollingBase
from thorvaldc.simulation.simulation_run import Simulation

DT = 0.02
SHAPES = [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.1, 0.1)]


def robot_with(trail: float, lateral: float) -> Robot:
    plain = make_robot(FOUR_STEERED)
    sides = (lateral, -lateral, 1.5 * lateral, 0.5 * lateral)
    wheels = zip(plain.wheels, sides, strict=True)
    return replace(
        plain,
        wheels=tuple(replace(w, trail=trail, lateral_offset=side) for w, side in wheels),
    )


def twist_at(time: float) -> Twist:
    """A smooth motion that never stops a steering axis."""
    size = 1.0 - math.cos(min(time, math.pi))
    return Twist(
        0.2 + 0.25 * size,
        0.08 * size * math.sin(0.7 * time),
        0.1 * size * math.sin(0.5 * time),
    )


@pytest.mark.parametrize(("trail", "lateral"), SHAPES)
def test_wheels_that_fit_the_motion_are_followed(trail: float, lateral: float) -> None:
    """The joints follow the rolling constraint of the contact point, with its steering rate.

    |u| sin(a - p) + c (wz + p') = 0 is solved by iteration over the whole path, from c p' = 0 on.
    """
    robot = robot_with(trail, lateral)
    base = RollingBase(robot)
    times = [DT * k for k in range(round(12.0 / DT) + 1)]
    angles, speeds = [], []
    for wheel in robot.wheels:
        axis = []
        for time in times:
            vx, vy, wz = twist_at(time)
            axis.append((vx - wz * wheel.y, vy + wz * wheel.x, wz))
        path = [math.atan2(uy, ux) for ux, uy, _ in axis]
        for _ in range(2):
            rates = [(b - a) / DT for a, b in zip([path[0], *path], path, strict=False)]
            path = [
                math.atan2(uy, ux) + math.asin(wheel.trail * (wz + rate) / math.hypot(ux, uy))
                for (ux, uy, wz), rate in zip(axis, rates, strict=True)
            ]
        angles.append(path)
        speeds.append(
            [
                (ux * math.cos(p) + uy * math.sin(p) - wheel.lateral_offset * (wz + rate))
                / wheel.radius
                for (ux, uy, wz), p, rate in zip(axis, path, rates, strict=True)
            ]
        )
    pose = ORIGIN
    for k, time in enumerate(times):
        states = base.read(time)
        if k > 60:
            for i in range(len(robot.wheels)):
                assert states.angles[i] == pytest.approx(angles[i][k - 1], abs=0.02)
                assert states.speeds[i] == pytest.approx(speeds[i][k - 1], abs=0.1)
        base.write(JointCommands([s[k] for s in speeds], [a[k] for a in angles]), time)
        pose = pose.moved(se2.exp(twist_at(time), DT))
    true = base.true_pose()
    assert math.hypot(true.x - pose.x, true.y - pose.y) < 0.1
    assert true.yaw == pytest.approx(pose.yaw, abs=0.02)


@pytest.mark.parametrize(("trail", "lateral"), SHAPES)
def test_encoders_agree_with_the_motion(trail: float, lateral: float) -> None:
    """Stops, reversals and wheels that turn on the spot; the odometry knows the same wheels."""
    twists = [
        (0.0, 0.8, 0.0, 0.0),
        (4.0, 0.0, 0.0, 0.0),
        (6.0, 0.0, 0.8, 0.0),
        (10.0, 0.0, 0.0, 0.8),
        (16.0, -0.8, 0.0, 0.0),
        (20.0, 0.5, 0.5, 0.0),
    ]
    fastest = 0.0

    def watch(loop: object) -> None:
        nonlocal fastest
        joints = loop.driver.state.joints  # type: ignore[attr-defined]
        if joints is not None:
            fastest = max([fastest, *map(abs, joints.speeds)])

    plan = [Segment(start, Twist(*twist)) for start, *twist in twists]
    run = Simulation(robot_with(trail, lateral), open_loop=True).run(26.0, plan, None, watch)
    result = run.robots[0]
    assert result.path_odometry == pytest.approx(result.path_true, rel=0.03)
    assert result.end_error < 0.2
    assert fastest < 10.0  # rad/s; a snap of a steering joint gives 100 rad/s
