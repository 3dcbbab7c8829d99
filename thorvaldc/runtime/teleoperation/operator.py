"""The interface of an operator: a person who commands twists with a keyboard or a joystick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from thorvaldc.runtime.se2 import Twist

FIRST_SHARE = 0.5
"""Initial share of the robot's top speed."""
SMALLEST_SHARE = 0.05
"""Smallest share of the top speed that an operator can select."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The top speeds of a robot, forward, sideways and turning.

    - ``linear``: top speed in m/s.
    - ``angular``: top angular speed in rad/s.
    - ``sideways``: true if the robot can move sideways.
    """

    linear: float
    angular: float
    sideways: bool

    @staticmethod
    def of(description: Mapping[str, Any]) -> Limits:
        """Returns the top speeds of a robot from the result of the service ``description``."""
        return Limits(
            description["max_linear_velocity"],
            description["max_angular_velocity"],
            description["sideways"],
        )

    def twist(self, x: float, y: float, yaw: float, share: float) -> Twist:
        """Returns the twist for the joystick or keyboard inputs ``x``, ``y`` and ``yaw``, each
        between -1 and 1.

        ``share`` is the fraction of the top speeds that the operator has selected.
        """
        lateral = self.linear if self.sideways else 0.0
        return Twist(x * share * self.linear, y * share * lateral, yaw * share * self.angular)


class Request(NamedTuple):
    """A call of a base driver service that the operator requests."""

    service: str
    arguments: Mapping[str, Any]


class Operator(Protocol):
    """A person who drives a robot with a keyboard or a joystick."""

    finished: bool
    """True if the operator has ended the teleoperation."""

    @property
    def share(self) -> float:
        """Fraction of the top speed that the operator has selected, 0 to 1."""

    @share.setter
    def share(self, share: float) -> None: ...

    @property
    def message(self) -> str:
        """A message for the operator, empty if there is no message."""

    def poll(self, now: float) -> list[Request]:
        """Reads all waiting input of the keyboard or joystick and returns the requested service
        calls.

        ``now`` is the monotonic time in s. The method returns immediately if no input is waiting.
        """

    def twist(self, now: float) -> Twist | None:
        """Returns the twist that the operator commands.

        Returns ``None`` if the operator commands no twist, so that another twist source may drive
        the robot.
        """

    def close(self) -> None: ...
