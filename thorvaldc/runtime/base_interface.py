"""The interface between the base driver and the joints of a simulated or real robot."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(slots=True)
class JointStates:
    """Measured joint states, with one entry per wheel in the order of ``Robot.wheels``.

    - ``time``: time of the measurement, s.
    - ``speeds``: wheel speeds, rad/s.
    - ``angles``: steering angles, rad.  The angles are calibrated: a steering angle is the
      encoder's reading plus ``Actuator.encoder_offset``.
    - ``angle_rates``: steering rates, rad/s.
    - ``positions``: positions of the spin joints in rad, not wrapped.  ``positions`` is ``None`` if
      the base does not measure positions.
    - ``yaw_rate``: yaw rate of ``base_link``, rad/s, measured by a gyro.  ``yaw_rate`` is ``None``
      if the robot has no gyro.

    The joint states of a joint without encoder are 0 and are not used.  Examples of joints without
    encoder are the spin joint of a wheel without motor and the steering joint of a wheel without
    steering.
    """

    time: float
    speeds: Sequence[float]
    angles: Sequence[float]
    angle_rates: Sequence[float]
    positions: Sequence[float] | None = None
    yaw_rate: float | None = None


class CheckedJointStates(JointStates):
    """Joint states that are known to be complete and finite, so nobody checks them again."""

    __slots__ = ()


@dataclass(slots=True)
class JointCommands:
    """Joint commands, with one entry per wheel in the order of ``Robot.wheels``.

    - ``speeds``: wheel speeds, rad/s.
    - ``angles``: steering angles, rad.
    """

    speeds: Sequence[float]
    angles: Sequence[float]


class BaseHandle(abc.ABC):
    """The joints of one robot, with the same interface for simulated and real robots.

    The parameter ``now`` of the methods is the monotonic time of the driver in s.  A simulated base
    advances its simulation to ``now``.
    """

    @property
    def hold_reason(self) -> str:
        """Reason why the base does not follow joint commands now, such as homing or a fault.

        The reason is an empty text if the base follows joint commands.
        """
        return ""

    @property
    def waiting_reason(self) -> str:
        """Reason why the base accepts no motion now although it follows joint commands.

        The reason is an empty text if the base accepts motion.  A base that needs no arming always
        accepts motion.
        """
        return ""

    @abc.abstractmethod
    def read(self, now: float) -> JointStates:
        """Returns the joint states at ``now``.  Unknown speeds, angles and positions are NaN."""

    @abc.abstractmethod
    def write(self, commands: JointCommands, now: float) -> None:
        """Sends joint commands to the base, valid from the time ``now`` (s)."""

    def expect_single_commands(self) -> None:
        """Informs the base that ``write`` is called for every change of a single joint's command.

        The calls of ``write`` for single joints are irregular in time.  The base therefore cannot
        compute steering rates from successive joint commands.
        """
        return

    def close(self) -> None:
        """Releases the resources of the base.

        After ``close``, the base no longer follows the last joint commands.
        """
        return
