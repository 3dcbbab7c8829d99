"""Inertial measurement units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from thorvaldc.runtime.odometry import DRIVE_ERROR_TIME, sum_of_autocorrelation
from thorvaldc.simulation.sensors.simulated_sensor import (
    Array,
    Measurement,
    SeenScene,
    SimulatedSensor,
    quaternion,
)


@dataclass(frozen=True, slots=True)
class ImuReading(Measurement):
    """A reading of an IMU, in its frame.

    - ``orientation``: quaternion w, x, y, z of the frame relative to east, north and up, or
      ``None`` if the unit does not know it.
    - ``angular_velocity``: (3) in rad/s.
    - ``acceleration``: (3) specific force in m/s^2: a unit at rest measures gravity upwards.
    - ``orientation_variance``, ``angular_velocity_variance``, ``acceleration_variance``: variances
      of each axis by the numbers of the module, see ``SensorSettings.for_filters``.
    """

    orientation: tuple[float, float, float, float] | None
    angular_velocity: Array
    acceleration: Array
    orientation_variance: float
    angular_velocity_variance: float
    acceleration_variance: float


class Imu(SimulatedSensor):
    """An IMU.

    The acceleration is the mean since the last reading, as in a unit that integrates between two
    readings, so that the impacts of a contact in a single step of the physics do not dominate it.
    A noise density d gives the standard deviation d sqrt(rate) of a reading.  The errors of the
    orientation last for ``orientation_time``, and biases for the whole run.
    """

    def reset(self) -> None:
        super().reset()
        values = self.numbers
        density = math.sqrt(values["rate"])
        self._gyro = values["gyro_noise"] * density
        self._accelerometer = values["accelerometer_noise"] * density
        self._gyro_bias = self._errors(values["gyro_bias"], 3)
        self._accelerometer_bias = self._errors(values["accelerometer_bias"], 3)
        self._last: tuple[float, Array, Array] | None = None

    def measure(self, seen: SeenScene) -> ImuReading:
        values, settings = self.numbers, self.settings
        _, rotation = self.pose(seen)
        motion = np.empty(6)
        kind = mujoco.mjtObj.mjOBJ_SITE
        mujoco.mj_objectVelocity(seen.model, seen.data, kind, self._site, motion, 0)
        turning, velocity = motion[:3], motion[3:]
        acceleration, mean_rotation = self._mean(seen.data.time, velocity, rotation)
        force = mean_rotation.T @ (acceleration - seen.gravity)
        gyro_errors = self._errors(self._gyro, 3) + self._gyro_bias
        deviation = self._gyro
        if settings.gyro is not None:
            gyro_errors = self.random.normal(settings.gyro_bias or 0.0, settings.gyro, 3)
            deviation = settings.gyro or deviation
        force_errors = self._errors(self._accelerometer, 3) + self._accelerometer_bias
        accuracy, lasting = values["orientation_accuracy"], values["orientation_time"]
        turn_errors = self._slow_errors(accuracy, lasting, seen.data.time)
        orientation = _turned(turn_errors, seen.level @ rotation) if accuracy else None
        orientation_variance, gyro_variance = accuracy**2, deviation**2
        if settings.for_filters:
            orientation_variance *= sum_of_autocorrelation(lasting, self.period)
            gyro_variance += 2.0 * DRIVE_ERROR_TIME / self.period * values["gyro_bias"] ** 2
        return ImuReading(
            *self._common(seen),
            orientation,
            rotation.T @ turning + gyro_errors,
            force + force_errors,
            orientation_variance,
            gyro_variance,
            self._accelerometer**2,
        )

    def _mean(self, time: float, velocity: Array, rotation: Array) -> tuple[Array, Array]:
        """Returns the mean acceleration (3) in the scene and the mean rotation (3, 3) since the
        last reading.  The first reading of a run takes the robot as at rest."""
        last = self._last
        if last is not None and time <= last[0]:
            return np.zeros(3), rotation
        self._last = (time, velocity.copy(), rotation)
        if last is None:
            return np.zeros(3), rotation
        return (velocity - last[1]) / (time - last[0]), (rotation + last[2]) / 2.0


def _turned(errors: Array, rotation: Array) -> tuple[float, float, float, float]:
    """Returns the quaternion of a rotation (3, 3) after small turns (3) in rad about east, north
    and up."""
    angle = float(np.linalg.norm(errors))
    turn, result = np.array([1.0, 0.0, 0.0, 0.0]), np.empty(4)
    if angle > 0.0:
        mujoco.mju_axisAngle2Quat(turn, errors / angle, angle)
    mujoco.mju_mulQuat(result, turn, np.array(quaternion(rotation)))
    w, x, y, z = result.tolist()
    return w, x, y, z
