"""The interface of operators: persons who command twists with a keyboard or a joystick."""

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
    """The robot's top speeds in m/s and rad/s; ``sideways``: it can move to the side."""

    linear: float
    angular: float
    sideways: bool

    @staticmethod
    def of(description: Mapping[str, Any]) -> Limits:
        """Returns the limits in the answer of the service ``description``."""
        return Limits(
            description["max_linear_velocity"],
            description["max_angular_velocity"],
            description["sideways"],
        )

    def twist(self, x: float, y: float, yaw: float, share: float) -> Twist:
        """Returns the twist for ``x``, ``y``, ``yaw`` in -1..1 and a share of the top speeds."""
        lateral = self.linear if self.sideways else 0.0
        return Twist(x * share * self.linear, y * share * lateral, yaw * share * self.angular)


class Request(NamedTuple):
    """A service call that the operator requests."""

    service: str
    arguments: Mapping[str, Any]


class Operator(Protocol):
    """A person at a keyboard or with a joystick."""

    finished: bool
    """Whether the operator ends the teleoperation."""

    @property
    def share(self) -> float:
        """Share of the top speed, 0..1."""

    @share.setter
    def share(self, share: float) -> None: ...

    @property
    def message(self) -> str:
        """A line for the operator; empty: none."""

    def poll(self, now: float) -> list[Request]:
        """Reads the device until ``now`` (s, monotonic) without waiting; returns the requests."""

    def twist(self, now: float) -> Twist | None:
        """Returns the commanded twist; ``None``: no command, another twist source may drive."""

    def close(self) -> None: ...
