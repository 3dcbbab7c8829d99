"""The interface between the base driver and the joints of a simulated or real robot."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(slots=True)
class JointStates:
    """Measured joint states, one entry per wheel in the order of ``Robot.wheels``.

    ``time`` (s): of the measurement.  Spin joints: ``speeds`` (rad/s) and ``positions`` (rad,
    not wrapped; ``None``: not measured).  Steering joints: ``angles`` (rad) and ``angle_rates``
    (rad/s).  Entries of joints without encoder (a wheel without motor, a wheel without steering)
    are 0 and unused.  ``yaw_rate`` (rad/s): of a gyro in ``base_link``, if the robot has one.
    Angles are calibrated: the encoder's reading plus ``Actuator.encoder_offset``.
    """

    time: float
    speeds: Sequence[float]
    angles: Sequence[float]
    angle_rates: Sequence[float]
    positions: Sequence[float] | None = None
    yaw_rate: float | None = None


@dataclass(slots=True)
class JointCommands:
    """Joint commands, one entry per wheel: spin speed (rad/s), steering angle (rad)."""

    speeds: Sequence[float]
    angles: Sequence[float]


class BaseHandle(abc.ABC):
    """The joints of one robot, with the same interface for simulated and real robots.

    ``now`` is a monotonic time in s from the driver; a simulated base advances to it.
    """

    @property
    def hold_reason(self) -> str:
        """Reason why the base follows no commands now (homing, a fault); empty: it follows them."""
        return ""

    @abc.abstractmethod
    def read(self, now: float) -> JointStates:
        """Returns the joint states at ``now``; NaN for unknown values."""

    @abc.abstractmethod
    def write(self, commands: JointCommands, now: float) -> None:
        """Sets the commands of the joints from ``now`` on."""

    def expect_single_commands(self) -> None:
        """Announces that ``write`` is called on every change of a single joint's command.

        The times of these calls are irregular.  The base cannot derive rates of set points from
        them.
        """
        return

    def close(self) -> None:
        """Releases the resources of the base.  It no longer follows the last commands."""
        return
