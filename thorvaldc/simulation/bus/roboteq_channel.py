"""A channel of the Roboteq controller: a motor with its encoder, in units of motor rpm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel, MotorState

STALL_TIME = 0.5
"""s at rest, despite a commanded speed, after which the channel reports a stall."""
STALL_RPM = 30.0
"""Commanded speed below which a motor at rest is not stalled."""
DRIVE = 0
"""Mode of a channel after power-on."""


@dataclass(frozen=True, slots=True)
class ChannelSettings:
    """Hardware of a channel.  ``limit`` (rad) bounds a steering angle to either side.

    ``steering`` ``False``: a propulsion motor.
    """

    gear_ratio: float
    encoder_pulses: int
    max_rpm: float
    max_torque: float = 0.0
    limit: float = math.pi
    steering: bool = False


class Channel:
    """A motor with its encoder.  ``position`` is in rad of the joint, ``rpm`` of the motor."""

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
        """Motor rpm."""
        self.acceleration = 0.0
        """Motor rpm per s; 0: as fast as the motor can."""

    @property
    def radians_per_rpm(self) -> float:
        """rad/s of the joint for one rpm of the motor."""
        return math.pi / 30.0 / self.settings.gear_ratio

    @property
    def counts(self) -> int:
        """The position in encoder counts."""
        return round(self.position * self.encoder.counts_per_radian)

    def start(self, now: float) -> None:
        """Starts after power-on; the encoder counts from the present position."""
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
        """Commands a speed within the speed limit; the motor model adds its own ramp."""
        setpoint = min(max(rpm, -self.max_rpm), self.max_rpm)
        if self.acceleration > 0.0:
            step = self.acceleration * dt
            setpoint = min(max(setpoint, self.setpoint - step), self.setpoint + step)
        self.setpoint = setpoint
        self.motor.turn(setpoint * self.radians_per_rpm, now)

    def stalled(self, now: float) -> bool:
        """The motor has not turned for a while, despite its command, or its encoder has failed."""
        if abs(self.setpoint) < STALL_RPM or abs(self.rpm) > STALL_RPM / 2.0:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
        return self._still_since is not None and now - self._still_since > STALL_TIME

    def release(self, now: float) -> None:
        self.setpoint = 0.0
        self.motor.release(now)
