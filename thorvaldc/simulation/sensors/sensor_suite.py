"""All sensors of the robots in a scene, which measure at their rates while the scene advances."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from thorvaldc.model import Robot
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene, SceneFiles
from thorvaldc.simulation.sensors.camera import Camera
from thorvaldc.simulation.sensors.gnss import Gnss
from thorvaldc.simulation.sensors.imu import Imu
from thorvaldc.simulation.sensors.lidar import Lidar
from thorvaldc.simulation.sensors.simulated_sensor import Message, SeenScene, SimulatedSensor

KINDS: Mapping[str, type[SimulatedSensor]] = {
    "lidar_2d": Lidar,
    "lidar_3d": Lidar,
    "imu": Imu,
    "gnss": Gnss,
    "camera": Camera,
}
"""Classes of the simulated sensors by the type of the sensor; other types are left out."""
Listener = Callable[[SimulatedSensor, Message], None]
"""Function that is called with each message of a run."""


class SensorSuite(Mapping[str, SimulatedSensor]):
    """The sensors of robots in a scene, by name; in a fleet with the name space: ``r1/lidar``.

    While the scene advances, each sensor measures at its rate: at the step of the physics that is
    nearest to the due time.  ``listeners`` are called with each message, in the order of the times.
    """

    def __init__(
        self,
        scene: MujocoScene,
        files: SceneFiles,
        robots: Sequence[Robot],
        settings: SensorSettings = SensorSettings(),
    ) -> None:
        """Makes the sensors of ``robots``, which measure from now on whenever the scene advances.

        ``files`` are those of the scene.  Raises ``DiagnosticError`` if they lack a sensor.
        """
        self._scene = scene
        # A lidar does not see its own robot, so that only several robots need visual shapes.
        self._seen = SeenScene(scene, files, visuals=settings.images or len(robots) > 1)
        self._sensors = {
            robot.prefix + sensor.name: KINDS[sensor.type](robot, sensor, self._seen, settings)
            for robot in robots
            for sensor in robot.sensors
            if sensor.type in KINDS
        }
        self.listeners: list[Listener] = []
        self.reset()
        scene.sensors = self

    def __getitem__(self, name: str) -> SimulatedSensor:
        return self._sensors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sensors)

    def __len__(self) -> int:
        return len(self._sensors)

    def reset(self) -> None:
        """Begins a run: the next measurements are due at once."""
        self._counts = dict.fromkeys(self._sensors, 0)
        for sensor in self._sensors.values():
            sensor.reset()
        self._seen.update()

    def advance(self, now: float) -> None:
        """Runs the scene from one due measurement to the next, up to the time ``now`` (s)."""
        sensors, counts, scene = self._sensors, self._counts, self._scene
        while sensors:
            due = min(counts[name] * sensor.period for name, sensor in sensors.items())
            if due > now + 1e-9:
                return
            scene.step_to(due)
            if scene.diverged:
                return
            self._seen.update()
            for name, sensor in sensors.items():
                if counts[name] * sensor.period > due + 1e-9:
                    continue
                counts[name] += 1
                for message in sensor.measure() if sensor.active else ():
                    sensor.latest = message
                    for listener in self.listeners:
                        listener(sensor, message)
