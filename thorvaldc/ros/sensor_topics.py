"""Topics of the simulated sensors of a node with the base ``mujoco``.

Names, types and frames are those of Gazebo (``backends.ros2_parts``), which the generated files of
slam_toolbox, Nav2 and robot_localization expect.
"""

from __future__ import annotations

import array
import importlib
from typing import Any

from thorvaldc.runtime.driven_robot import DrivenRobot

DEPTH = 10
"""Messages that wait in a topic.  The topics are reliable, which fits subscribers of both kinds:
navsat_transform asks for reliable ones, slam_toolbox and Nav2 for best effort."""
_COSTLY = ("lidar_2d", "lidar_3d", "camera")
"""Types of sensors that measure only while their topics have subscribers."""


class SensorTopics:
    """The publishers of a node for the sensors of its robot.

    ``entities``: the publishers that the node removes.
    """

    def __init__(self, node: Any) -> None:
        from thorvaldc.backends.ros2_parts import sensor_topics  # not on a robot's computer

        self._publishers = {
            node.model.prefix + sensor.name: {
                kind: node.create_publisher(_class_of(kind), topic, DEPTH)
                for topic, kind, _ in sensor_topics(sensor)
            }
            for sensor in node.model.sensors
        }
        self.entities = [p for topics in self._publishers.values() for p in topics.values()]
        self._measured: list[tuple[Any, Any]] = []

    def attach(self, robot: DrivenRobot) -> None:
        """Takes the measurements of a robot in MuJoCo from now on."""
        self._sensors: Any = robot.base.scene.sensors  # type: ignore[attr-defined]
        self._measured.clear()
        self._sensors.listeners.append(lambda *measured: self._measured.append(measured))

    def publish(self) -> None:
        """Publishes what was measured since the last call."""
        from thorvaldc.simulation.sensors.ros_messages import build, messages

        for sensor, measurement in self._measured:
            publishers = self._publishers[sensor.name]
            for message in messages(measurement):
                publishers[message.type].publish(build(message, _class_of, _sequence, tuple))
        self._measured.clear()
        for name, sensor in self._sensors.items():
            sensor.active = sensor.sensor.type not in _COSTLY or any(
                p.get_subscription_count() for p in self._publishers[name].values()
            )


def _class_of(kind: str) -> Any:
    package, _, name = kind.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _sequence(values: Any) -> Any:
    # rclpy checks each number of a list, and takes an array of the right type as it is.
    return array.array(values.dtype.char, values.tobytes())
