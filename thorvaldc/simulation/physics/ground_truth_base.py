"""Interface of a simulated base that knows the true motion of the robot."""

from __future__ import annotations

import abc

from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.runtime.se2 import Pose2, Twist


class GroundTruthBase(BaseHandle):
    """A simulated base that also returns the true motion, for measurements only.

    The base driver uses ``BaseHandle`` alone.
    """

    @abc.abstractmethod
    def true_pose(self) -> Pose2:
        """Returns the pose of ``base_link`` on the ground, in the world."""

    @abc.abstractmethod
    def true_twist(self) -> Twist:
        """Returns the velocity of ``base_link`` on the ground, in ``base_link``."""

    def posture(self) -> tuple[float, float, float]:
        """Returns the height of ``base_link`` over the ground plane (m), roll and pitch (rad)."""
        return 0.0, 0.0, 0.0

    def uprightness(self) -> float:
        """Returns the cosine of the robot's tilt: 1 upright, 0 on its side."""
        return 1.0

    def leaning(self) -> str:
        """Returns the direction of the largest lean, such as `to its left`; empty if unknown."""
        return ""
