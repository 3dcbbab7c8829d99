"""Inertial measurement units."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from thorvaldc.runtime.filter_covariance import sum_of_autocorrelation
from thorvaldc.simulation.sensors.simulated_sensor import (
    Array,
    Message,
    SimulatedSensor,
    diagonal,
    quaternion,
)

BIAS_TIME = 15.0
"""Time constant (s) of the bias of a gyro for a filter, which takes errors as independent: with the
bias of the whole drive, the yaw of the filter has the right variance after 30 s."""


class Imu(SimulatedSensor):
    """An IMU, whose orientation is relative to east, north and up.

    The acceleration is the specific force (at rest, gravity upwards) as the mean since the last
    reading, as in a unit that integrates between two readings, so that the impacts of a contact in
    a single step of the physics do not dominate it.  A noise density d gives the standard deviation
    d sqrt(rate) of a reading.  The errors of the orientation last for ``orientation_time``, and
    biases for the whole run.
    """

    def reset(self) -> None:
        super().reset()
        density = math.sqrt(self.numbers["rate"])
        self._accuracy = self.numbers["orientation_accuracy"]
        self._gyro = self.numbers["gyro_noise"] * density
        self._accelerometer = self.numbers["accelerometer_noise"] * density
        self.gyro_bias = self._errors(self.numbers["gyro_bias"], 3)
        self._accelerometer_bias = self._errors(self.numbers["accelerometer_bias"], 3)
        self._last: tuple[float, Array, Array] | None = None

    def measure(self) -> list[Message]:
        seen, noise = self.seen, self.settings.noise
        _, rotation = self.pose()
        motion = np.empty(6)
        kind = mujoco.mjtObj.mjOBJ_SITE
        mujoco.mj_objectVelocity(seen.model, seen.data, kind, self._site, motion, 0)
        acceleration, mean_rotation = self._mean(motion[3:], rotation)
        gyro_errors, deviation = self._errors(self._gyro, 3) + self.gyro_bias, self._gyro
        if noise.gyro is not None:
            gyro_errors = self.random.normal(noise.gyro_bias, noise.gyro, 3)
            deviation = noise.gyro or deviation
        force = mean_rotation.T @ (acceleration - seen.model.opt.gravity) + self._accelerometer_bias
        w, *xyz = self._orientation(rotation)
        values, variance, gyro_variance = self.numbers, self._accuracy**2, deviation**2
        if self.settings.for_filters:
            variance *= sum_of_autocorrelation(values["orientation_time"], self.period)
            gyro_variance += 2.0 * BIAS_TIME / self.period * values["gyro_bias"] ** 2
        # REP 145: -1 marks an orientation that the unit does not know.
        known = diagonal(variance) if variance else (-1.0, *[0.0] * 8)
        message = self._message(
            "Imu",
            orientation=_vector("Quaternion", (*xyz, w)),
            orientation_covariance=known,
            angular_velocity=_vector("Vector3", rotation.T @ motion[:3] + gyro_errors),
            angular_velocity_covariance=diagonal(gyro_variance),
            linear_acceleration=_vector("Vector3", force + self._errors(self._accelerometer, 3)),
            linear_acceleration_covariance=diagonal(self._accelerometer**2),
        )
        return [message]

    def _mean(self, velocity: Array, rotation: Array) -> tuple[Array, Array]:
        """Returns the mean acceleration (3) in the scene and the mean rotation (3, 3) since the
        last reading.  The first reading of a run takes the robot as at rest."""
        last, now = self._last, self.seen.data.time
        if last is None or now > last[0]:
            self._last = (now, velocity, rotation)
        if last is None or now <= last[0]:
            return np.zeros(3), rotation
        return (velocity - last[1]) / (now - last[0]), (rotation + last[2]) / 2.0

    def _orientation(self, rotation: Array) -> list[float]:
        """Returns the quaternion w, x, y, z after small turns about east, north and up."""
        errors = self._slow_errors(self._accuracy, self.numbers["orientation_time"])
        turn, result = np.array([1.0, *(errors / 2.0)]), np.empty(4)
        mujoco.mju_normalize4(turn)
        mujoco.mju_mulQuat(result, turn, np.array(quaternion(self.seen.level @ rotation)))
        return list(map(float, result))


def _vector(kind: str, values: Any) -> Message:
    fields = zip("xyzw", map(float, values), strict=False)
    return Message(f"geometry_msgs/msg/{kind}", **dict(fields))
