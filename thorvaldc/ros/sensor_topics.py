"""Topics of the simulated sensors of a node with the base ``mujoco``.

Names, types and frames are those of Gazebo (``backends.ros2_parts``), which the generated files of
slam_toolbox, Nav2 and robot_localization expect.
"""

from __future__ import annotations

import array
import importlib
from typing import Any

from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.settings import FOR_FILTERS
from thorvaldc.ros.bases import scene_files
from thorvaldc.runtime.driven_robot import DrivenRobot

DEPTH = 10
"""Messages that wait in a topic.  The topics are reliable, which fits subscribers of both kinds:
navsat_transform asks for reliable ones, slam_toolbox and Nav2 for best effort."""
_COSTLY = ("lidar_2d", "lidar_3d", "camera")
"""Types of sensors that measure only while their topics have subscribers."""


class SensorTopics:
    """The publishers of a node for the sensors of its robot; the node removes ``entities``."""

    def __init__(self, node: Any) -> None:
        from thorvaldc.backends.ros2_parts import sensor_topics  # not on a robot's computer

        self._node = node
        self._publishers = {
            (sensor.name, kind): node.create_publisher(_class_of(kind), topic, DEPTH)
            for sensor in node.model.sensors
            for topic, kind, _ in sensor_topics(sensor)
        }
        self.entities = list(self._publishers.values())

    def attach(self, robot: DrivenRobot) -> None:
        """Makes the sensors of a robot in MuJoCo measure, for ``publish``."""
        from thorvaldc.simulation.sensors.sensor_suite import SensorSuite

        model, values = self._node.model, self._node.values
        for_filters = values["twist_covariance"] == FOR_FILTERS
        settings = SensorSettings(values["sensor_errors"], values["publish_images"], for_filters)
        files, base = scene_files(model, self._node.model_file, values["world"]), robot.base
        self._sensors = SensorSuite(base.scene, files, [model], settings)  # type: ignore[attr-defined]
        self._pending: list[Any] = []
        self._sensors.listeners.append(lambda *measured: self._pending.append(measured))

    def publish(self) -> None:
        """Publishes what was measured since the last call."""
        for sensor, message in self._pending:
            publisher = self._publishers[sensor.sensor.name, message.ros_type]
            publisher.publish(message.build(_class_of, _array))
        self._pending.clear()
        for sensor in self._sensors.values():
            name = sensor.sensor.name
            sensor.active = sensor.sensor.type not in _COSTLY or any(
                p.get_subscription_count() for (n, _), p in self._publishers.items() if n == name
            )


def _class_of(kind: str) -> Any:
    package, _, name = kind.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _array(values: Any) -> Any:
    # rclpy checks each number of a list, and takes an array of the right type as it is.
    return values if isinstance(values, tuple) else array.array(values.dtype.char, values.tobytes())
