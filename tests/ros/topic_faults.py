"""Joint states that are missing or wrong: each is a fault with its reason, and the robot stops.

``python -m tests.ros.topic_faults MODEL_JSON DIALECT``
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any

from tests.ros.topic_rig import TopicRig, stamp
from thorvaldc.model.stopping import STOP_LOCK, stop_bounds

NOTICED = 0.35  # s, with which a wheel that stands is 0.3 rad behind its target


def main() -> None:
    rig = TopicRig(*sys.argv[1:])
    before_the_first_joint_states(rig)
    rig.start()
    rig.drive(0.5, 60)
    assert rig.robot.driver.state.mode.value == "driving"
    assert abs(rig.odometry[-1].twist.twist.linear.x - 0.5) < 0.01
    assert rig.odometry[-1].header.stamp == stamp(rig.now)
    silence(rig)
    for change, reason in CHANGES:
        recover(rig)
        wrong_messages(rig, change, reason)
    recover(rig)
    joints_that_do_not_move(rig)
    recover(rig)
    a_jump_back(rig)
    recover(rig)
    a_pause(rig)
    end(rig)


def before_the_first_joint_states(rig: TopicRig) -> None:
    """Nothing is commanded, and the robot cannot be armed."""
    rig.set_clock(rig.now)
    for _ in range(5):
        rig.node.run_due()
    assert rig.heard == 0
    assert rig.fault().startswith("no joint states have come on /engine/joint_states yet") or (
        "joint_state_broadcaster" in rig.fault()
    )
    assert refusal(lambda: rig.robot.call("arm")) == rig.fault()


def silence(rig: TopicRig) -> None:
    """After 0.1 s the drives get the speed 0, and no odometry is published any more."""
    published = len(rig.odometry)
    rig.silence(0.08)
    assert rig.robot.armed, rig.fault()
    rig.silence(0.6)
    rig.spin_until(lambda: not any(rig.commands.speeds))
    assert rig.fault().startswith("no joint states on /")
    assert rig.robot.driver.state.mode.value in ("fault", "waiting")
    assert not rig.robot.armed
    assert len(rig.odometry) == published
    assert refusal(lambda: rig.robot.call("reset_faults")) == rig.fault()


def first(message: Any, field: str, value: float) -> None:
    getattr(message, field)[0] = value


def without_a_joint(message: Any) -> None:
    for field in (message.name, message.position, message.velocity):
        del field[0]


def of_another_robot(message: Any) -> None:
    message.name = [f"other/{name}" for name in message.name]


def without_a_number(message: Any) -> None:
    del message.velocity[-1]


def without_a_stamp(message: Any) -> None:
    message.header.stamp = stamp(0.0)


def behind(message: Any) -> None:
    message.header.stamp = stamp(
        message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 - 0.9
    )


CHANGES: list[tuple[Callable[[Any], None], str]] = [
    (lambda message: first(message, "position", math.nan), "has the position nan"),
    (lambda message: first(message, "velocity", math.inf), "and the speed inf"),
    (without_a_joint, "the state of "),
    (of_another_robot, "no joint is one of "),
    (without_a_number, "`velocity` has "),
    (without_a_stamp, "have no stamp"),
    (behind, "0.9 s behind the time of this node"),
]


def wrong_messages(rig: TopicRig, change: Callable[[Any], None], reason: str) -> None:
    """Wrong messages count as missing: the driver goes on for 0.1 s, and then stops the robot."""
    for _ in range(40):
        rig.now += rig.robot.period
        rig.set_clock(rig.now)
        message = rig.message()
        change(message)
        rig.take(message)
        rig.node.run_due()
        rig.follow()
    rig.spin_until(lambda: not any(rig.commands.speeds))
    assert reason in rig.fault(), (reason, rig.fault())
    assert not rig.robot.armed


def joints_that_do_not_move(rig: TopicRig) -> None:
    """The joint states stay frozen at full speed; the last command ends in a ramp all the same."""
    bound = {stop.kind: stop for stop in stop_bounds(rig.model)}[STOP_LOCK]
    way, fault_at, last = 0.0, math.nan, list(rig.commands.speeds)
    begin = rig.now
    while any(rig.commands.speeds):
        rig.send(0.5)
        rig.cycle()
        way += max(map(abs, rig.commands.speeds)) * rig.model.wheels[0].radius * rig.robot.period
        if rig.fault():
            fault_at = min(rig.now, fault_at)
            pairs = zip(rig.commands.speeds, last, strict=True)
            assert all(abs(speed) <= abs(before) + 1e-12 for speed, before in pairs)
        last = list(rig.commands.speeds)
        assert rig.now - begin < NOTICED + bound.time, rig.commands.speeds
    assert any(rig.states.speeds), "they are frozen while they turn"
    assert fault_at - begin < NOTICED
    assert way < 0.5 * NOTICED + bound.distance
    assert "the joint " in rig.fault(), rig.fault()
    assert "does not follow its target" in rig.fault(), rig.fault()
    assert rig.fault() in refusal(lambda: rig.robot.call("arm"))


def a_jump_back(rig: TopicRig) -> None:
    """The engine was reset: the pose of the odometry stays, and its stamps are the new ones."""
    x = rig.odometry[-1].pose.pose.position.x
    rig.now = 0.5
    rig.set_clock(rig.now)
    rig.drive(0.5, 40)
    assert not any(rig.commands.speeds)
    assert rig.fault().startswith("the time of the joint states jumped back by"), rig.fault()
    assert not rig.robot.armed
    rig.cycle()
    assert abs(rig.robot.driver.state.pose.x - x) < 0.12  # while it ramps to rest
    rig.spin_until(lambda: rig.odometry[-1].header.stamp == stamp(rig.now))


def a_pause(rig: TopicRig) -> None:
    """While the time stands, nothing happens; a twist from then does not move the robot.

    A paused Gazebo sends its joint states again and again.
    """
    rig.drive(0.5, 40)
    cycles = rig.robot.timing.cycles
    for _ in range(20):
        rig.take()
    rig.spin_until(lambda: bool(rig.node.run_due() or rig.node.clock_watch.problem))
    rig.send(0.5)
    assert rig.robot.timing.cycles == cycles
    assert rig.robot.armed
    rig.drive(0.5, 60)
    assert abs(rig.robot.driver.state.odometry.twist.vx) < 1e-3
    rig.drive(0.0, 2)
    rig.drive(0.5, 60)
    assert abs(rig.robot.driver.state.odometry.twist.vx - 0.5) < 0.01


def recover(rig: TopicRig) -> None:
    """Resets the fault, arms the robot and drives; it has stood until then."""
    for _ in range(150):  # a robot is not armed for 2 s after a gap in time
        rig.send(0.0)
        rig.cycle()
        rig.follow()
        assert not any(rig.commands.speeds)
    while rig.robot.void_reason():  # messages may have waited, for 0.5 s of real time
        time.sleep(0.02)
    if rig.fault():
        rig.robot.call("reset_faults")
    rig.start()
    rig.drive(0.5, 40)
    assert rig.fault() == ""
    assert rig.robot.driver.state.mode.value == "driving"


def end(rig: TopicRig) -> None:
    """The end of the node stops the drives although no joint states come any more."""
    assert any(rig.commands.speeds)
    rig.node.stop_robot()
    rig.spin_until(lambda: not any(rig.commands.speeds))


def refusal(call: Callable[[], object]) -> str:
    try:
        call()
    except Exception as error:
        return str(error)
    return ""


if __name__ == "__main__":
    main()
