"""The connection of simulated motors and encoders to the channels of their motor controllers.

A motor controller closes the loop over the encoder of its channel.  Positions and speeds in the
frame of the channel, which the motor controller measures and commands::

    reading = direction * encoder_scale * (joint position - zero)

The loop is stable if the encoder is that of the motor and counts in the direction of the motor
(``encoder_scale > 0``).  The joint then has the speed ``command / (direction * encoder_scale)``.
Otherwise the measured speed does not approach the command: the motor gets its whole voltage until
the motor controller takes the torque away.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thorvaldc.simulation.bus.simulated_motors import MotorModel, MotorState

_CLOSED = 1e-4
"""Difference (rad, rad/s) of command and reading at which an unstable loop applies no voltage."""


class Wiring(NamedTuple):
    """The motor and the encoder on a channel of a motor controller.

    - ``motor``: name of the actuator whose motor the channel turns, empty for its own.
    - ``encoder``: name of the actuator whose encoder the channel reads, empty for that of
      ``motor``.
    - ``direction``: -1 if the motor with its encoder is mounted otherwise than the file says.
    - ``encoder_scale``: counts of the encoder per count that the robot file expects.  Below 0 the
      encoder counts against the motor.
    - ``zero``: displacement (rad) of the home position of the joint.
    """

    motor: str = ""
    encoder: str = ""
    direction: int = 1
    encoder_scale: float = 1.0
    zero: float = 0.0


class WiredMotor(MotorModel):
    """A motor in the frame of the channel that it is connected to, see the module."""

    def __init__(
        self,
        motor: MotorModel,
        max_velocity: float,
        *,
        encoder_of: MotorModel | None = None,
        direction: int = 1,
        encoder_scale: float = 1.0,
        zero: float = 0.0,
    ) -> None:
        """``max_velocity``: speed (rad/s) of the joint at the whole voltage.

        ``encoder_of``: motor whose joint the encoder measures, by default ``motor``.
        """
        self.motor = motor
        self._max_velocity = max_velocity
        self._encoder_of = encoder_of or motor
        self.direction = direction
        self._gain = direction * encoder_scale
        self._zero = zero
        self._is_stable = encoder_scale > 0.0 and self._encoder_of is motor

    @property
    def blocked(self) -> bool:
        return self.motor.blocked

    @blocked.setter
    def blocked(self, blocked: bool) -> None:
        self.motor.blocked = blocked

    def disturb(self, now: float, *, push: float = 0.0, runaway: float | None = None) -> None:
        turned = None if runaway is None else self.direction * runaway
        self.motor.disturb(now, push=self.direction * push, runaway=turned)

    def read(self, now: float) -> MotorState:
        state, gain = self._encoder_of.read(now), self._gain
        torque = self.motor.read(now).torque if self._encoder_of is not self.motor else state.torque
        return MotorState(
            gain * (state.position - self._zero), gain * state.velocity, self.direction * torque
        )

    def turn(self, velocity: float, now: float) -> None:
        if self._is_stable:
            self.motor.turn(velocity / self._gain, now)
        else:
            self._apply_voltage(velocity - self.read(now).velocity, now)

    def hold(self, position: float, now: float) -> None:
        if self._is_stable:
            self.motor.hold(self._zero + position / self._gain, now)
        else:
            self._apply_voltage(position - self.read(now).position, now)

    def release(self, now: float) -> None:
        self.motor.release(now)

    def _apply_voltage(self, error: float, now: float) -> None:
        voltage = math.copysign(1.0, error) if abs(error) > _CLOSED else 0.0
        self.motor.turn(self.direction * voltage * self._max_velocity, now)
