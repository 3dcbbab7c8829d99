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
            (node.model.prefix + sensor.name, kind): node.create_publisher(
                _class_of(kind), topic, DEPTH
            )
            for sensor in node.model.sensors
            for topic, kind, _ in sensor_topics(sensor)
        }
        self.entities = list(self._publishers.values())

    def attach(self, robot: DrivenRobot) -> None:
        """Publishes the messages of a robot in MuJoCo from now on, when ``publish`` is called."""
        self._pending: list[tuple[Any, Any]] = []
        self._sensors: Any = robot.base.scene.sensors  # type: ignore[attr-defined]
        self._sensors.listeners.append(lambda *measured: self._pending.append(measured))

    def publish(self) -> None:
        """Publishes what was measured since the last call."""
        for sensor, message in self._pending:
            publisher = self._publishers[sensor.name, message.ros_type]
            publisher.publish(message.build(_class_of, _array))
        self._pending.clear()
        for sensor in self._sensors.values():
            sensor.active = sensor.sensor.type not in _COSTLY
        for (name, _), publisher in self._publishers.items():
            self._sensors[name].active |= publisher.get_subscription_count() > 0


def _class_of(kind: str) -> Any:
    package, _, name = kind.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _array(values: Any) -> Any:
    # rclpy checks each number of a list, and takes an array of the right type as it is.
    return values if isinstance(values, tuple) else array.array(values.dtype.char, values.tobytes())
