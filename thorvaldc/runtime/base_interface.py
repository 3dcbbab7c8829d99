"""The interface between the base driver and the joints of a simulated or real robot."""

from __future__ import annotations

import abc
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.runtime.motion_supervision import Axis, Deviation
from thorvaldc.runtime.mypyc_marks import mypyc_attr
from thorvaldc.runtime.service_table import Service


class ComponentStatus(NamedTuple):
    """State of a part of a base, such as a bus or a motor controller.

    - ``level``: ``ok``, ``warning`` or ``error``;
    - ``text``: one line for the operator;
    - ``values``: values as JSON, by name.
    """

    name: str
    level: str
    text: str
    values: Mapping[str, Any]


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


@mypyc_attr(allow_interpreted_subclasses=True)
class BaseHandle(abc.ABC):
    """The joints of one robot, with the same interface for simulated and real robots.

    The parameter ``now`` of the methods is the monotonic time of the driver in s.  A simulated base
    advances its simulation to ``now``.

    A base must read and write joints.  All other methods tell what else it can do: their defaults
    are those of ideal joints, which are always ready and have no batteries, stops and services.
    """

    @property
    def hold_reason(self) -> str:
        """Reason why the base does not follow joint commands now, such as homing or a fault.

        The reason is an empty text if the base follows joint commands.
        """
        return ""

    @property
    def lost(self) -> str:
        """Reason why the joints cannot be reached any more, or an empty text."""
        return ""

    @property
    def speed_share(self) -> float:
        """Share (0 to 1) of the limits of the twist that the base allows, such as less than 1 while
        a battery is low."""
        return 1.0

    @property
    def disarming_reason(self) -> str:
        """Reason why the robot must come to rest and be disarmed, or an empty text."""
        return ""

    @property
    def period(self) -> float | None:
        """Period (s) of the control cycle, or ``None`` for the period of the driver's settings."""
        return None

    @property
    def longest_stop(self) -> float:
        """Longest time (s) after ``end`` in which the base comes to rest."""
        return 10.0

    @property
    def is_homed(self) -> bool:
        """``False`` if steering joints must find their home position before the robot drives."""
        return True

    @property
    def is_homing(self) -> bool:
        """``True`` while steering joints find their home position."""
        return False

    @property
    def ended(self) -> bool:
        """``True`` if the joints are at rest and have no torque after ``end``, as far as known."""
        return True

    @property
    def lacks_joint_states(self) -> bool:
        """``True`` while no joint state can be measured, so that no odometry is published."""
        return False

    @property
    def longest_interval(self) -> float | None:
        """Longest time (s) between two control cycles that is no gap, see ``pace``; ``None``: as it
        follows from the period."""
        return None

    @property
    def gaps_are_faults(self) -> bool:
        """``True`` if the motors have torque and can move while no control cycle runs."""
        return False

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

    def arming_reasons(self, now: float) -> Iterable[str]:
        """Returns the reasons of the base against arming the robot at ``now`` (s)."""
        return filter(None, (self.hold_reason, self.disarming_reason))

    def home(self, now: float, *, again: bool = False) -> str:
        """Starts to home the steering joints, with ``again`` also those that are homed.

        Returns the reason if this is refused.
        """
        return "this base has no joints to home"

    def cancel_homing(self, now: float) -> None:
        """Stops a homing; the joints have to be homed again."""
        return

    def safety_stop(self, engaged: bool) -> None:
        """Stops all motors and switches them off, or releases this stop."""
        return

    def reset(self, now: float, commanded: bool) -> str:
        """Leaves a fault or a stop of the base.  Returns the reason if this is refused.

        ``commanded``: a motion is commanded, so that the reset must be refused.
        """
        return ""

    def fail(self, reason: str) -> None:
        """Puts the base into a fault because of a gap in time, which it does not see itself."""
        return

    @property
    def axes(self) -> Sequence[Axis]:
        """Motors whose motion the driver compares with their targets, see ``motion_supervision``.

        None where nothing lies between a command and its joint, as in a simulation.
        """
        return ()

    def disobeyed(self, deviations: Sequence[Deviation], now: float) -> None:
        """Stops the robot, because these motors do not follow their targets."""
        return

    def note_cycle(self, now: float, *, stale: bool) -> None:
        """Ends a control cycle.  ``stale``: the robot does not follow a fresh twist."""
        return

    def end(self) -> None:
        """Begins the end of the run: the base stops all joints, then takes their torque away."""
        return

    def leave(self) -> None:
        """Sends the last messages after ``ended``."""
        return

    def batteries(self) -> Mapping[str, Any]:
        """Returns the states of the batteries (``BatteryState``) by name."""
        return {}

    def supply(self) -> Any | None:
        """Returns the state of the batteries that supply the robot together (``BatteryState``).

        ``None``: there is no such common source, see ``Robot.common_source``.
        """
        return None

    def sources(self) -> list[Any]:
        """Returns the state of the common source, or without one those of all batteries."""
        supply = self.supply()
        return list(self.batteries().values()) if supply is None else [supply]

    def motor_controller_data(self, now: float) -> Mapping[str, Mapping[str, float]]:
        """Returns what each motor controller reports, by its name and the name of the signal.

        The values are in the units of the signals, and NaN while no report arrives.
        """
        return {}

    def io_data(self, now: float) -> Mapping[str, Mapping[str, float]]:
        """Returns what each IO board reports, by its name and the name of the signal."""
        return {}

    def warnings(self, now: float) -> list[str]:
        """Returns warnings about the base that do not stop the robot."""
        return []

    def values(self) -> dict[str, Any]:
        """Returns what the service ``state`` says about the base, as JSON values."""
        return {}

    def component_statuses(self, now: float) -> Iterable[ComponentStatus]:
        """Returns the states of the parts of the base, for an operator."""
        return ()

    def send_to_device(self, frame: CanFrame, now: float) -> str:
        """Relays a CAN frame to a foreign device.  Returns the reason if it is refused."""
        return "the robot has no bus"

    def frames_from_devices(self) -> Iterable[CanFrame]:
        """Returns the CAN frames that foreign devices have sent since the last call."""
        return ()

    def other_joints(self) -> Mapping[str, tuple[float, float]]:
        """Returns the position (rad, m) and speed of joints that the driver does not command."""
        return {}

    def services(self) -> Sequence[Service]:
        """Returns the services that only this kind of base has."""
        return ()

    def close(self) -> None:
        """Releases the resources of the base.

        After ``close``, the base no longer follows the last joint commands.
        """
        return


class NotFiniteError(ValueError):
    """A twist or a joint state contains a NaN or an infinity.

    The function that raises ``NotFiniteError`` changes nothing.
    """


class ParameterError(ValueError):
    """The name or the value of a driver parameter is invalid.

    The function that raises ``ParameterError`` changes nothing.
    """


class RequestRefused(ValueError):
    """A service of the robot refused a request and changed nothing.

    The message of the exception contains the reason for the refusal.
    """
