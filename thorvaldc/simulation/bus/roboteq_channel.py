"""A channel of a motor controller: a motor with its encoder, told and read in motor rpm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel, MotorState

STALL_TIME = 0.5
NOISE_RPM = 30.0
DRIVE = 0
"""The mode in which a channel starts."""


@dataclass(frozen=True, slots=True)
class ChannelSettings:
    """A motor on a channel: ``max_rpm`` of the motor, ``limit`` (rad) of a steering's angle.

    ``steering`` ``False``: a propulsion motor.
    """

    gear_ratio: float
    encoder_pulses: int
    max_rpm: float
    max_torque: float = 0.0
    limit: float = math.pi
    steering: bool = False


class Channel:
    """A motor with its encoder; speeds in motor rpm, forward or not as ``direction`` says."""

    def __init__(self, settings: ChannelSettings, motor: MotorModel) -> None:
        self.settings = settings
        self.motor = motor
        self.encoder = Encoder(settings.gear_ratio, settings.encoder_pulses)
        self.mode = DRIVE
        self.max_rpm = settings.max_rpm
        self.rpm = 0.0
        self.position = 0.0
        self.state = MotorState(0.0, 0.0, 0.0)
        self.encoder_fault = False
        self._still_since: float | None = None
        self.setpoint = 0.0
        self.acceleration = 0.0
        """Motor rpm per s; 0: as fast as the motor can."""

    @property
    def radians_per_rpm(self) -> float:
        """rad/s of the joint for one rpm of the motor."""
        return math.pi / 30.0 / self.settings.gear_ratio

    @property
    def counts(self) -> int:
        return round(self.position * self.encoder.counts_per_radian)

    def start(self, now: float) -> None:
        self.mode = DRIVE
        self.max_rpm, self.acceleration = self.settings.max_rpm, 0.0
        self.encoder_fault, self._still_since, self.setpoint = False, None, 0.0
        self.encoder.set_zero(self.motor.read(now))
        self.measure(now)

    def measure(self, now: float) -> None:
        self.state = self.motor.read(now)
        self.position, velocity = self.encoder.measure(self.state)
        self.rpm = velocity / self.radians_per_rpm

    def turn(self, rpm: float, now: float, dt: float) -> None:
        """At most at its speed limit; the rest of the ramp is the motor's own."""
        wanted = min(max(rpm, -self.max_rpm), self.max_rpm)
        if self.acceleration > 0.0:
            step = self.acceleration * dt
            wanted = min(max(wanted, self.setpoint - step), self.setpoint + step)
        self.setpoint = wanted
        self.motor.turn(wanted * self.radians_per_rpm, now)

    def stalled(self, now: float) -> bool:
        """Asked to turn and standing for a while: stuck, or its encoder does not count."""
        if abs(self.setpoint) < NOISE_RPM or abs(self.rpm) > NOISE_RPM / 2.0:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
        return self._still_since is not None and now - self._still_since > STALL_TIME

    def release(self, now: float) -> None:
        self.setpoint = 0.0
        self.motor.release(now)
