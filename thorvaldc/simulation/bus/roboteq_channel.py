"""A motor channel of the simulated Roboteq controller.

The controller measures and commands the speed of the motor in rpm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel, MotorState

STALL_TIME = 0.5
"""Time (s) at rest with a commanded speed after which the channel reports a stall."""
STALL_RPM = 30.0
"""Commanded speed (rpm) below which a motor at rest does not count as stalled."""
DRIVE = 0
"""Mode of a channel after power-on."""


@dataclass(frozen=True, slots=True)
class ChannelSettings:
    """Hardware settings of a motor channel of the Roboteq controller.

    ``steering`` is true for a steering motor, and false for a propulsion motor.  ``limit`` is the
    largest steering angle (rad) in both directions.
    """

    gear_ratio: float
    encoder_pulses: int
    max_rpm: float
    max_torque: float = 0.0
    limit: float = math.pi
    steering: bool = False


class Channel:
    """A channel of the Roboteq controller with a motor and an encoder.

    ``position`` is the joint position (rad), and ``rpm`` is the speed of the motor (rpm).
    """

    def __init__(self, settings: ChannelSettings, motor: MotorModel) -> None:
        self.settings = settings
        self.motor = motor
        self.encoder = Encoder(settings.gear_ratio, settings.encoder_pulses)
        self.mode = DRIVE
        self.max_rpm = settings.max_rpm
        self.rpm = 0.0
        self.position = 0.0
        self.state = MotorState(0.0, 0.0, 0.0)
        self.encoder_error = False
        self._still_since: float | None = None
        self.setpoint = 0.0
        """Commanded motor speed (rpm)."""
        self.acceleration = 0.0
        """Acceleration limit (rpm per s), or 0 for the largest acceleration of the motor."""

    @property
    def radians_per_rpm(self) -> float:
        """Speed of the joint (rad/s) at a motor speed of 1 rpm."""
        return math.pi / 30.0 / self.settings.gear_ratio

    @property
    def counts(self) -> int:
        """Joint position in encoder counts."""
        return round(self.position * self.encoder.counts_per_radian)

    def start(self, now: float) -> None:
        """Starts the motor channel after power-on.

        The encoder count is 0 at the present position of the joint.
        """
        self.mode = DRIVE
        self.max_rpm, self.acceleration = self.settings.max_rpm, 0.0
        self.encoder_error, self._still_since, self.setpoint = False, None, 0.0
        self.encoder.set_zero(self.motor.read(now))
        self.measure(now)

    def measure(self, now: float) -> None:
        self.state = self.motor.read(now)
        self.position, velocity = self.encoder.measure(self.state)
        self.rpm = velocity / self.radians_per_rpm

    def turn(self, rpm: float, now: float, dt: float) -> None:
        """Commands a motor speed (rpm), limited by the speed limit of the motor channel.

        The motor model limits the acceleration of the motor.
        """
        setpoint = min(max(rpm, -self.max_rpm), self.max_rpm)
        if self.acceleration > 0.0:
            step = self.acceleration * dt
            setpoint = min(max(setpoint, self.setpoint - step), self.setpoint + step)
        self.setpoint = setpoint
        self.motor.turn(setpoint * self.radians_per_rpm, now)

    def stalled(self, now: float) -> bool:
        """Returns true if the measured motor speed is too low for longer than ``STALL_TIME``.

        The measured speed is too low if the motor does not follow the commanded speed, or if the
        encoder failed.
        """
        if abs(self.setpoint) < STALL_RPM or abs(self.rpm) > STALL_RPM / 2.0:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
        return self._still_since is not None and now - self._still_since > STALL_TIME

    def release(self, now: float) -> None:
        self.setpoint = 0.0
        self.motor.release(now)
