"""A person who drives: what the hand asks for, with a dead-man switch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from thorvaldc.runtime.se2 import Twist

FIRST_SHARE = 0.5
"""Of the robot's top speed, to start with."""
SMALLEST_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Limits:
    """The robot's top speeds (m/s, rad/s), and whether it can move ``sideways``."""

    linear: float
    angular: float
    sideways: bool

    @staticmethod
    def of(description: Mapping[str, Any]) -> Limits:
        """Those in the answer of the service ``description``."""
        return Limits(
            description["max_linear_velocity"],
            description["max_angular_velocity"],
            description["sideways"],
        )

    def twist(self, x: float, y: float, yaw: float, share: float) -> Twist:
        """Of parts -1..1 of the top speeds, times ``share``."""
        side = self.linear if self.sideways else 0.0
        return Twist(x * share * self.linear, y * share * side, yaw * share * self.angular)


class Request(NamedTuple):
    """A service that the operator asks for, with its arguments."""

    service: str
    arguments: Mapping[str, Any]


class Operator(Protocol):
    """Somebody at a keyboard, with a joystick."""

    finished: bool
    """Whether the person wants to end it."""

    @property
    def share(self) -> float:
        """Of the top speed."""

    @share.setter
    def share(self, share: float) -> None: ...

    @property
    def message(self) -> str:
        """A line for the person, empty if none."""

    def poll(self, now: float) -> list[Request]:
        """Look what the hand has done until ``now`` (s, monotonic); never waits."""

    def twist(self, now: float) -> Twist | None:
        """What is asked for; ``None``: nothing, so that another source may drive."""

    def close(self) -> None: ...
