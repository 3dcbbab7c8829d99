"""A simulated base: what only a simulation knows of a robot."""

from __future__ import annotations

import abc

from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.runtime.se2 import Pose2, Twist


class SimulatedBase(BaseHandle):
    """A base that also knows what only a simulation knows, for whoever measures."""

    @abc.abstractmethod
    def true_pose(self) -> Pose2:
        """Pose of ``base_link`` on the ground."""

    @abc.abstractmethod
    def true_twist(self) -> Twist:
        """Velocity of ``base_link`` in itself, on the ground."""

    def posture(self) -> tuple[float, float, float]:
        """Height (m) of ``base_link`` over the ground's plane, its roll and pitch (rad)."""
        return 0.0, 0.0, 0.0

    def uprightness(self) -> float:
        """Cosine of the robot's tilt: 1 upright, 0 on its side."""
        return 1.0

    def leaning(self) -> str:
        """The way in which the robot leans most, such as `to its left`; empty if unknown."""
        return ""
