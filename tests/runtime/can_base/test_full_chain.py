"""Driver, bus, simulated controllers and MuJoCo, together and in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.runtime.can_base.test_can_base import EXAMPLES, four_wheels
from tests.simulation.bus.robots import drives
from tests.slow import mostly_exhaustive
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import Segment, twist_at
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene


@pytest.mark.slow
def test_the_odometry_experiment_over_the_bus() -> None:
    """The asymmetric six-wheeler drives about 80 m in 77 s; odometry ends within 0.1 m.

    The driver knows the joints only from the controllers' frames: whole revolutions per minute and
    whole counts, measured at different times.
    """
    scenario = compile_file(EXAMPLES / "odometry_experiment" / "ideal.yaml").scenario
    assert scenario is not None
    robot = scenario.fleet.placements[0].robot
    base = MujocoBase(robot, MujocoScene(emit(robot, ["mjcf"])))
    rig = Rig(robot, base=base)
    rig.ready()
    rig.arm()
    commands = scenario.commands[0][1]
    plan = [Segment(rig.now + c.time, Twist(c.vx, c.vy, c.wz)) for c in commands]
    end = rig.now + scenario.duration

    def feed(driver: BaseDriver, now: float) -> None:
        driver.command(twist_at(plan, now), now)

    rig.driven.feed = feed
    rig.driven.call("reset_odometry")
    start = last = base.true_pose()
    path = 0.0
    start_time = rig.now
    while rig.now < end + 0.5:
        rig.run(0.1)
        pose = base.true_pose()
        path += math.hypot(pose.x - last.x, pose.y - last.y)
        last = pose
    assert 77.0 < rig.now - start_time < 78.5
    assert path == pytest.approx(78.5, abs=0.3)  # as docs/driving.md states
    true, estimated = base.true_pose().relative_to(start), rig.driven.driver.state.pose
    assert math.hypot(true.x - estimated.x, true.y - estimated.y) <= 0.1
    assert abs(math.remainder(true.yaw - estimated.yaw, math.tau)) < 0.02
    assert rig.base.incomplete == 0
    rig.driven.shutdown()


@pytest.mark.parametrize(
    "make", mostly_exhaustive([drives, four_wheels]), ids=["cia402", "roboteq"]
)
def test_hard_ramps_of_a_heavy_robot_are_no_fault(make: Callable[[], Robot]) -> None:
    """Loaded motors lag behind their targets: neither the drives nor the driver report a fault."""
    robot = make()
    rig = Rig(robot, base=MujocoBase(robot, MujocoScene(emit(robot, ["mjcf"]))), seed=3)
    rig.ready()
    rig.arm()
    top, turn = robot.driver.max_linear_velocity, robot.driver.max_angular_velocity
    for vx, vy, wz in ((top, 0, 0), (-top, 0, 0), (0, top, 0), (0, 0, turn), (0, -top, -turn)):
        rig.twist = Twist(vx, vy, wz)
        rig.run(2.0)
        assert rig.state is BaseState.ACTIVE, rig.reason
    rig.twist = None  # the longest ramp: from full speed to rest
    rig.until(lambda: rig.state is BaseState.READY, 5.0)
