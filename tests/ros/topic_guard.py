"""The guard stops the drives when the base driver is silent, and only then.

``python -m tests.ros.topic_guard MODEL_JSON DIALECT``
"""

from __future__ import annotations

import sys
from typing import Any
from unittest.mock import patch

from rclpy.parameter import Parameter

from tests.ros.topic_rig import TopicRig
from thorvaldc.ros.joint_guard import JointGuard
from thorvaldc.ros.message_wait import handle_messages

STOP = 3.0  # s: the ramp of the robot from 0.5 m/s, and the wait for joint states before it


def main() -> None:
    model_file, dialect = sys.argv[1:]
    rig = TopicRig(model_file, dialect)
    values = {"model_file": model_file, "joint_topics": dialect, "use_sim_time": True}
    guard = JointGuard(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
    rig.executor.add_node(guard)
    rig.work = guard.run_due
    rig.spin_until(lambda: len(guard.get_publishers_info_by_topic("/engine/heartbeat")) > 0)
    rig.start()
    rig.drive(0.5, 60)
    heard = rig.heard
    rig.spin_until(lambda: False, longest=0.5)  # the time stands: that is no silence
    assert rig.heard == heard
    assert all(rig.commands.speeds[wheel] > 0.0 for wheel in rig.drives.values())
    angles = list(rig.commands.angles)
    for _ in range(20):  # the driver is dead, and the time goes on
        rig.now += 0.02
        rig.set_clock(rig.now)
        rig.spin_until(lambda: False, longest=0.01)
    rig.spin_until(lambda: not any(rig.commands.speeds))
    assert rig.heard - heard < 20 * rig.expected
    assert rig.commands.angles == angles
    rig.work = lambda: None
    rig.executor.remove_node(guard)
    guard.destroy_node()
    waits: list[float] = []

    def wait(node: Any, subscriptions: Any, longest: float) -> None:
        waits.append(longest)
        handle_messages(node, subscriptions, longest=longest)

    with patch("thorvaldc.ros.topic_base.handle_messages", wait):
        rig.close()  # the engine is silent: the robot ends all the same
    assert 0.0 < sum(waits) < STOP, sum(waits)


if __name__ == "__main__":
    main()
