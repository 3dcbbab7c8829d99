"""The base as joints: what a driver sees of a robot, simulated or real."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(slots=True)
class JointStates:
    """Measured joints, one entry per wheel in the order of ``Robot.wheels``.

    ``speeds`` (rad/s) and ``positions`` (rad, not wrapped; ``None``: the base
    does not count turns) are those of the wheels' spin joints, ``angles`` (rad)
    and ``angle_rates`` (rad/s) those of their steering joints.  Entries of
    joints that have no encoder (a wheel without motor, a wheel that is not
    steered) are 0 and are not looked at.  ``time`` (s) is when they were measured.
    ``yaw_rate`` (rad/s) is that of a gyro in ``base_link``, where there is one.
    Angles are the joints' positions with the robot's calibration applied: the
    encoder's reading plus ``Actuator.encoder_offset``.
    """

    time: float
    speeds: Sequence[float]
    angles: Sequence[float]
    angle_rates: Sequence[float]
    positions: Sequence[float] | None = None
    yaw_rate: float | None = None


@dataclass(slots=True)
class JointCommands:
    """Asked of the joints, one entry per wheel: spin speed (rad/s), steering angle (rad)."""

    speeds: Sequence[float]
    angles: Sequence[float]


class BaseHandle(abc.ABC):
    """The joints of one robot.  A driver cannot tell a simulated base from a real one.

    ``now`` is a monotonic time in s that the driver gives; a simulated base
    moves on to it.
    """

    @property
    def hold_reason(self) -> str:
        """Why the base follows no commands now (it finds its home, a fault); empty: it does."""
        return ""

    @abc.abstractmethod
    def read(self, now: float) -> JointStates:
        """The joints as they are at ``now``; NaN for what is not known."""

    @abc.abstractmethod
    def write(self, commands: JointCommands, now: float) -> None:
        """Ask these of the joints from ``now`` on."""

    def expect_single_commands(self) -> None:
        """From now on ``write`` is called whenever one joint's command changes.

        It tells nothing of the rates of set points then: its times are nobody's cycle.
        """
        return

    def close(self) -> None:
        """Let go of what the base holds.  The last commands are no longer followed."""
        return
