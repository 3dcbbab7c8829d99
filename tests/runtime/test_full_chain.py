"""Driver, bus, simulated controllers and MuJoCo, together and in virtual time."""

from __future__ import annotations

import math

from bench.odometry import MANUAL
from tests.runtime.can_base_rig import Rig
from tests.runtime.test_can_base import example
from thorvaldc.pipeline import emit
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.manoeuvre import Segment, twist_at
from thorvaldc.runtime.mujoco_base import MujocoBase, MujocoScene
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


def test_the_odometry_experiment_over_the_bus() -> None:
    """The asymmetric six-wheeler drives about 80 m in 77 s; odometry ends within 0.1 m.

    All that is known of the joints are the controllers' frames: whole revolutions per minute
    and whole counts, at times that nothing keeps together.
    """
    robot = example("6wd6ws_asymmetric")
    base = MujocoBase(robot, MujocoScene(emit(robot, ["mjcf"])))
    rig = Rig(robot, base=base)
    rig.ready()
    plan, at = [], rig.now
    for seconds, *twist in MANUAL:
        plan.append(Segment(at, Twist(*twist)))
        at += seconds
    plan.append(Segment(at - 2.0, ZERO_TWIST))

    def feed(driver: BaseDriver, now: float) -> None:
        driver.command(twist_at(plan, now), now)

    rig.runner.feed = feed
    rig.runner.reset_odometry()
    start = last = base.true_pose()
    path = 0.0
    begun = rig.now
    while rig.now < at + 0.5:
        rig.run(0.1)
        pose = base.true_pose()
        path += math.hypot(pose.x - last.x, pose.y - last.y)
        last = pose
    assert 77.0 < rig.now - begun < 78.5
    assert path > 75.0
    true, found = base.true_pose().relative_to(start), rig.runner.driver.state.pose
    assert math.hypot(true.x - found.x, true.y - found.y) <= 0.1
    assert abs(math.remainder(true.yaw - found.yaw, math.tau)) < 0.02
    assert rig.base.incomplete == 0
    rig.runner.shutdown()
