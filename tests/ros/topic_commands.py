"""For equal joint states, the base `topics` commands the same as the base `mujoco`.

``python -m tests.ros.topic_commands DIALECT MODEL_JSON ...`` prints the largest difference of a
speed (rad/s) or an angle (rad) for each model.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

from tests.ros.topic_rig import SOURCE, TopicRig
from thorvaldc.ros.bases import open_robot
from thorvaldc.runtime.se2 import Twist

CYCLES = 150


def twist_at(cycle: int) -> Twist:
    """Returns a twist that turns the steering and changes direction, after zero."""
    if cycle < 10:
        return Twist(0.0, 0.0, 0.0)
    return Twist(0.4 * math.sin(cycle / 40), 0.0, 0.3 * math.sin(cycle / 25))


def reference(rig: TopicRig, model_file: str) -> list[tuple[Any, Any]]:
    """Returns the joint states and the commands of each cycle of the base `mujoco`."""
    robot = open_robot(rig.model, Path(model_file), "mujoco", "", 0.0)
    base, cycles = robot.driver.base, []
    read, write = base.read, base.write

    def keep_read(now: float) -> Any:
        cycles.append([read(now), None])
        return cycles[-1][0]

    def keep_write(commands: Any, now: float) -> None:
        cycles[-1][1] = commands
        write(commands, now)

    base.read, base.write = keep_read, keep_write  # type: ignore[method-assign]
    for cycle in range(CYCLES):
        if cycle == 5:
            robot.call("arm")
        robot.multiplexer.publish(SOURCE, twist_at(cycle), robot.now, "ROS")
        robot.run_due_cycle()
    robot.close()
    return [(states, commands) for states, commands in cycles]


def largest_difference(dialect: str, model_file: str) -> float:
    rig = TopicRig(model_file, dialect)
    largest = 0.0
    for cycle, (states, commands) in enumerate(reference(rig, model_file)):
        rig.states = states
        if cycle == 0:
            rig.set_clock(rig.now + rig.robot.period if rig.robot else rig.now)
        if cycle == 5:
            rig.robot.call("arm")
        twist = twist_at(cycle)
        rig.send(twist.vx, twist.wz)
        rig.cycle()
        pairs = [(rig.commands.speeds[i], commands.speeds[i]) for i in rig.drives.values()]
        pairs += [(rig.commands.angles[i], commands.angles[i]) for i in rig.steering.values()]
        largest = max(largest, *(abs(ours - theirs) for ours, theirs in pairs))
    moved = max(map(abs, states.speeds))
    rig.close()
    assert moved > 0.1, "the robot of the reference stands"
    return largest


def main() -> None:
    dialect, *models = sys.argv[1:]
    print(json.dumps({model: largest_difference(dialect, model) for model in models}))


if __name__ == "__main__":
    main()
