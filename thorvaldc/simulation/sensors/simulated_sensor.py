"""What all simulated sensors have: their place in the scene, their rate, their random errors."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from thorvaldc.model import Robot, Sensor
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.sensor_numbers import sensor_numbers
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

Array = Any
"""Array of numpy.  Its shape is in the documentation."""


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


class SceneState:
    """Poses and velocities in a scene at its present time.

    After a step, the arrays of MuJoCo have the poses at the beginning of the step.  They are
    computed here in arrays of their own, so that sensors do not change the motion of a run.

    - ``data``: the ``MjData`` with these poses and velocities.
    - ``level``: (3, 3) rotation from the frame of the scene to east, north and up.  The frame of a
      scene on a slope is the plane of the slope, with a tilted gravity; the rotation is the
      smallest one that makes gravity point down.
    """

    def __init__(self, scene: MujocoScene) -> None:
        self.scene = scene
        self.data = mujoco.MjData(scene.model)
        self.gravity = scene.model.opt.gravity.copy()
        self.level = _level(self.gravity)

    def update(self) -> None:
        """Computes the poses and velocities at the present time of the scene."""
        model, data = self.scene.model, self.data
        data.qpos[:] = self.scene.data.qpos
        data.qvel[:] = self.scene.data.qvel
        data.time = self.scene.time
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
        self, robot: Robot, sensor: Sensor, scene: MujocoScene, settings: SensorSettings
    ) -> None:
        self.name = robot.prefix + sensor.name
        self.frame = robot.prefix + sensor.link
        self.numbers = sensor_numbers(sensor)
        self.period = 1.0 / self.numbers["rate"]
        self.settings = settings
        self.robot, self.sensor = robot, sensor
        self.active = True
        self.latest: Measurement | None = None
        self._site = scene.index("site", self.name, robot)
        self._base = scene.index("body", robot.prefix + robot.links[0].name, robot)
        self.reset()

    def reset(self) -> None:
        """Begins a run: equal runs have equal errors."""
        # SHA-256, because the function hash() of a text differs between processes.
        text = f"{self.settings.seed} {self.name}"
        digest = hashlib.sha256(text.encode()).digest()
        self.random = np.random.default_rng(int.from_bytes(digest))
        self.latest = None

    def measure(self, state: SceneState) -> Measurement:
        """Returns the measurement at the time of ``state``, with the errors of the sensor."""
        raise NotImplementedError

    def pose(self, state: SceneState) -> tuple[Array, Array]:
        """Returns the position (3) in m and the rotation (3, 3) of the frame in the scene."""
        data = state.data
        return data.site_xpos[self._site].copy(), data.site_xmat[self._site].reshape(3, 3).copy()

    def _errors(self, deviation: float, count: int) -> Array:
        """Returns ``count`` independent normal errors, scaled by the settings."""
        return self.random.normal(0.0, deviation * self.settings.errors, count)

    def _common(self, state: SceneState) -> tuple[str, float, str, tuple[float, ...]]:
        """Returns the fields of ``Measurement``."""
        position, rotation = self.pose(state)
        base = state.data.xmat[self._base].reshape(3, 3)
        x, y, z = base.T @ (position - state.data.xpos[self._base])
        qw, qx, qy, qz = quaternion(base.T @ rotation)
        mount = (float(x), float(y), float(z), qx, qy, qz, qw)
        return self.name, state.data.time, self.frame, mount


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """Returns the quaternion w, x, y, z of a rotation (3, 3)."""
    result = np.empty(4)
    mujoco.mju_mat2Quat(result, rotation.ravel())
    w, x, y, z = result.tolist()
    return w, x, y, z
