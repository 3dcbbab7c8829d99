"""All sensors of the robots in a scene, which measure at their rates while the scene advances."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from thorvaldc.model import Robot
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene, SceneFiles
from thorvaldc.simulation.sensors.camera import Camera
from thorvaldc.simulation.sensors.gnss import Gnss
from thorvaldc.simulation.sensors.imu import Imu
from thorvaldc.simulation.sensors.lidar import Lidar
from thorvaldc.simulation.sensors.simulated_sensor import Message, SeenScene, SimulatedSensor

_KINDS = {"lidar_2d": Lidar, "lidar_3d": Lidar, "imu": Imu, "gnss": Gnss, "camera": Camera}
Listener = Callable[[SimulatedSensor, Message], None]
"""Function that is called with each message of a run."""


class SensorSuite(dict[str, SimulatedSensor]):
    """The sensors of robots in a scene, by name; in a fleet with the name space: ``r1/lidar``.

    While the scene advances, each sensor measures at its rate: at the step of the physics that is
    nearest to the due time.  ``listeners`` and the ``recorders`` of the present run are called with
    each message, in the order of the times.
    """

    def __init__(
        self,
        scene: MujocoScene,
        files: SceneFiles,
        robots: Sequence[Robot],
        settings: SensorSettings,
    ) -> None:
        """Makes the sensors of ``robots``, which measure from now on whenever the scene advances.

        ``files`` are those of the scene.  Raises ``DiagnosticError`` if they lack a sensor.
        """
        self._scene = scene
        # A lidar does not see its own robot, so that only several robots need visual shapes.
        self._seen = SeenScene(scene, files, visuals=settings.images or scene.model.ntree > 1)
        for robot in robots:
            for sensor in robot.sensors:
                if sensor.type in _KINDS:
                    kind: type[SimulatedSensor] = _KINDS[sensor.type]
                    self[robot.prefix + sensor.name] = kind(robot, sensor, self._seen, settings)
        self.listeners: list[Listener] = []
        self.recorders: list[Listener] = []
        self.reset()
        scene.sensors = self

    def reset(self) -> None:
        """Begins a run at the present time of the scene."""
        # The next multiple of the period, which is 0 at the start of the scene.
        now = self._scene.time - 1e-9
        self._counts = {name: math.ceil(now / sensor.period) for name, sensor in self.items()}
        self._due = {name: self._counts[name] * sensor.period for name, sensor in self.items()}
        for sensor in self.values():
            sensor.reset()
        self._seen.update()

    @property
    def state(self) -> tuple[dict[str, int], dict[str, float], dict[str, dict[str, object]]]:
        """The counts and the due times of the sensors, and the attributes of each; can be set."""
        own = {name: {**vars(sensor)} for name, sensor in self.items()}
        for attributes in own.values():
            del attributes["seen"]
        return self._counts, self._due, own

    @state.setter
    def state(
        self, value: tuple[dict[str, int], dict[str, float], dict[str, dict[str, object]]]
    ) -> None:
        self._counts, self._due, own = value
        for name, attributes in own.items():
            vars(self[name]).update(attributes)
        self._seen.update()

    def advance(self, now: float) -> None:
        """Runs the scene from one due measurement to the next, up to the time ``now`` (s)."""
        scene, times = self._scene, self._due
        while times and (due := min(times.values())) <= now + 1e-9:
            scene.step_to(due)
            if scene.diverged:
                return
            self._seen.update()
            for name, sensor in self.items():
                if times[name] > due + 1e-9:
                    continue
                self._counts[name] += 1
                times[name] = self._counts[name] * sensor.period
                for message in sensor.measure() if sensor.active else ():
                    sensor.latest = message
                    for listener in (*self.listeners, *self.recorders):
                        listener(sensor, message)
