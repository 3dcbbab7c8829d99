"""What all simulated sensors have: their place in the scene, their rate, their random errors."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from thorvaldc.model import Robot, Sensor
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.sensor_numbers import sensor_numbers
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

Array = Any
"""Array of numpy.  Its shape is in the documentation."""
SceneFiles = Path | str | Mapping[str, bytes]
VISUAL_GROUP, PLATE_GROUP = 2, 1
"""Groups of the visual geoms in MJCF files, and of those of zones for sensors."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """A measurement of a sensor.

    - ``sensor``: name of the sensor, with the name space of its robot, such as ``r1/lidar``.
    - ``time``: simulated time in s.
    - ``frame``: name of the measurement frame, with the name space.
    - ``mount``: pose of the measurement frame in ``base_link`` at that time: x, y, z in m and the
      quaternion x, y, z, w.
    """

    sensor: str
    time: float
    frame: str
    mount: tuple[float, ...]


class SeenScene:
    """A second scene of the same files for the sensors, with the poses of the simulated one.

    After a step, the arrays of MuJoCo have the poses at the beginning of the step, and the physics
    needs no visual shapes.  With a scene of their own, sensors do not change the motion of a run.

    - ``scene``, ``model``, ``data``: the scene and its objects of MuJoCo.
    - ``gravity``: (3) in m/s^2.
    - ``level``: (3, 3) rotation from the frame of the scene to east, north and up.  The frame of a
      scene on a slope is the plane of the slope, with a tilted gravity; the rotation is the
      smallest one that makes gravity point down.
    """

    def __init__(self, files: SceneFiles, *, visuals: bool) -> None:
        self.scene = MujocoScene(files, visuals=visuals)
        self.model, self.data = self.scene.model, self.scene.data
        # Zones are visible plates a millimetre above the ground, which no ray shall hit.
        plates = (self.model.geom_bodyid == 0) & (self.model.geom_group == VISUAL_GROUP)
        self.model.geom_group[plates] = PLATE_GROUP
        self.gravity = self.model.opt.gravity.copy()
        self.level = _level(self.gravity)

    def update(self, simulated: MujocoScene) -> None:
        """Takes the joint positions and velocities of the simulated scene at its present time."""
        model, data = self.model, self.data
        data.qpos[:], data.qvel[:] = simulated.data.qpos, simulated.data.qvel
        data.time = simulated.time
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)


def _level(gravity: Array) -> Array:
    """Returns the rotation that turns the direction against gravity into the z axis.

    With the unit vectors u = -g/|g| and v = u x z, and c = u . z, Rodrigues' formula is
    I + [v] + [v]^2 / (1 + c).
    """
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.eye(3)
    x, y, z = (-gravity / size).tolist()
    skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + z)


class SimulatedSensor:
    """A sensor of a robot in a scene.

    - ``name``, ``frame``: as in ``Measurement``.
    - ``period``: time between two measurements in s.
    - ``active``: false if nobody needs the measurements.
    - ``latest``: last measurement of a run, or ``None``.
    """

    def __init__(
        self, robot: Robot, sensor: Sensor, seen: SeenScene, settings: SensorSettings
    ) -> None:
        self.name = robot.prefix + sensor.name
        self.frame = robot.prefix + sensor.link
        self.numbers = sensor_numbers(sensor)
        self.period = 1.0 / self.numbers["rate"]
        self.settings = settings
        self.robot, self.sensor = robot, sensor
        self.active = True
        self.latest: Measurement | None = None
        self._site = seen.scene.index("site", self.name, robot)
        self._base = seen.scene.index("body", robot.prefix + robot.links[0].name, robot)
        self.reset()

    def reset(self) -> None:
        """Begins a run: equal runs have equal errors."""
        # SHA-256, because the function hash() of a text differs between processes.
        text = f"{self.settings.seed} {self.name}"
        digest = hashlib.sha256(text.encode()).digest()
        self.random = np.random.default_rng(int.from_bytes(digest))
        self.latest = None
        self._slow: Array | None = None
        self._slow_time = 0.0

    def measure(self, seen: SeenScene) -> Measurement:
        """Returns the measurement at the time of ``seen``, with the errors of the sensor."""
        raise NotImplementedError

    def pose(self, seen: SeenScene) -> tuple[Array, Array]:
        """Returns the position (3) in m and the rotation (3, 3) of the frame in the scene."""
        data = seen.data
        return data.site_xpos[self._site].copy(), data.site_xmat[self._site].reshape(3, 3).copy()

    def _errors(self, deviation: float, count: int) -> Array:
        """Returns ``count`` independent normal errors, scaled by the settings."""
        return self.random.normal(0.0, deviation * self.settings.errors, count)

    def _slow_errors(self, deviation: float, correlation_time: float, now: float) -> Array:
        """Returns the present errors (3) of a first-order Gauss-Markov process.

        After the time t, an error is exp(-t/T) of its old value plus a new error, with the
        correlation time T; its standard deviation stays ``deviation``.
        """
        kept = math.exp(-(now - self._slow_time) / correlation_time)
        if self._slow is None:
            self._slow, kept = np.zeros(3), 0.0
        new = self._errors(deviation * math.sqrt(1.0 - kept * kept), 3)
        self._slow, self._slow_time = kept * self._slow + new, now
        return self._slow

    def _common(self, seen: SeenScene) -> tuple[str, float, str, tuple[float, ...]]:
        """Returns the fields of ``Measurement``."""
        position, rotation = self.pose(seen)
        base = seen.data.xmat[self._base].reshape(3, 3)
        x, y, z = base.T @ (position - seen.data.xpos[self._base])
        qw, qx, qy, qz = quaternion(base.T @ rotation)
        mount = (float(x), float(y), float(z), qx, qy, qz, qw)
        return self.name, seen.data.time, self.frame, mount


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """Returns the quaternion w, x, y, z of a rotation (3, 3)."""
    result = np.empty(4)
    mujoco.mju_mat2Quat(result, rotation.ravel())
    w, x, y, z = result.tolist()
    return w, x, y, z
