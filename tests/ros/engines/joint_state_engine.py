"""A MuJoCo scene with JointState topics, like Isaac Sim with its nodes for joint states.

``joint_state_engine.py --scene scene.xml --speed-topic T --angle-topic T --state-topic T``
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from sensor_msgs.msg import JointState

from tests.ros.engines.joint_engine import JointEngine, Motions, common_arguments
from tests.ros.engines.mujoco_joints import POSITION, VELOCITY, MujocoJoints

RATE = 60.0  # Hz, the default rate of Isaac Sim's time line


class JointStateEngine(JointEngine):
    """Commands by JointState; a message may command angles, speeds, or both."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.scene = MujocoJoints(options.scene, RATE)
        self.wraps = options.wrap
        super().__init__("joint_state_engine", self.scene, options, RATE, RATE)
        self.publish_states_on(options.state_topic)
        topics = {VELOCITY: options.speed_topic, POSITION: options.angle_topic}
        for topic in {t: None for t in topics.values() if t}:
            channels = [c for c, t in topics.items() if t == topic]
            self.hear(JointState, topic, channels, self._take(topic, channels))

    def _take(self, topic: str, channels: list[str]) -> Any:
        def take(message: JointState) -> list[str]:
            commands = {VELOCITY: message.velocity, POSITION: message.position}
            given = {interface: values for interface, values in commands.items() if values}
            if reason := self._refusal(message, given):
                print(f"error: {topic}: {reason}", file=sys.stderr, flush=True)
                return []
            for interface, values in given.items():
                for joint, value in zip(message.name, values, strict=True):
                    if math.isfinite(value):
                        self.scene.command(joint, interface, value)
            return channels if len(channels) == 1 else [c for c in channels if c in given]

        return take

    def _refusal(self, message: JointState, given: dict[str, Any]) -> str:
        if not given:
            return "there is neither a position nor a velocity"
        for interface, values in given.items():
            if len(values) != len(message.name):
                return f"{len(values)} values of {interface} for {len(message.name)} names"
            for joint in message.name:
                if joint not in self.scene.names:
                    return f"there is no joint {joint!r}"
                if (joint, interface) not in self.scene.inputs:
                    return f"the joint {joint!r} takes no {interface}"
        return ""

    def motions_of_message(self) -> Motions:
        motions = super().motions_of_message()
        if self.wraps:
            for joint in self.scene.unlimited & motions.keys():
                position, velocity = motions[joint]
                motions[joint] = (math.fmod(position, 2.0 * math.pi), velocity)
        return motions


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, required=True, help="MJCF file")
    parser.add_argument("--speed-topic", required=True)
    parser.add_argument("--angle-topic", default="", help="none for a robot without steering")
    parser.add_argument("--state-topic", required=True)
    parser.add_argument("--wrap", action="store_true", help="angles within 2 pi, if unlimited")
    common_arguments(parser)
    return JointStateEngine(parser.parse_args()).run()


if __name__ == "__main__":
    raise SystemExit(main())
