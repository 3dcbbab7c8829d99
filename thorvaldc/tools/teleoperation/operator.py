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
    """The top speeds of a robot.

    - ``linear``: top speed in m/s.
    - ``angular``: top angular speed in rad/s.
    - ``sideways``: true if the robot can move sideways.
    """

    linear: float
    angular: float
    sideways: bool

    @staticmethod
    def of(description: Mapping[str, Any]) -> Limits:
        """Returns the limits of a robot from the result of the service ``description``."""
        return Limits(
            description["max_linear_velocity"],
            description["max_angular_velocity"],
            description["sideways"],
        )

    def twist(self, x: float, y: float, yaw: float, share: float) -> Twist:
        """Returns the twist for the inputs ``x``, ``y`` and ``yaw``, each between -1 and 1.

        ``share`` is the selected share of the top speeds.
        """
        lateral = self.linear if self.sideways else 0.0
        return Twist(x * share * self.linear, y * share * lateral, yaw * share * self.angular)


class Request(NamedTuple):
    """A service call that the operator requests."""

    service: str
    arguments: Mapping[str, Any]


class Operator(Protocol):
    """A person who drives a robot with a keyboard or a joystick."""

    finished: bool
    """True if the operator has ended the teleoperation."""

    @property
    def share(self) -> float:
        """Selected share of the top speed, 0 to 1."""

    @share.setter
    def share(self, share: float) -> None: ...

    @property
    def message(self) -> str:
        """A line of text for the operator, empty if there is no message."""

    def poll(self, now: float) -> list[Request]:
        """Reads all waiting input of the device and returns the requested service calls.

        ``now`` is the monotonic time in s. The method never waits for input.
        """

    def twist(self, now: float) -> Twist | None:
        """Returns the commanded twist.

        Returns ``None`` if the operator commands no twist, so another twist source may drive.
        """

    def close(self) -> None: ...
