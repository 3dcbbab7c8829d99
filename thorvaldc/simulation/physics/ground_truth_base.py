"""Interface of a simulated base that knows the true motion of the robot."""

from __future__ import annotations

import abc

from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.physics.simulated_joints import SimulatedJoints


class GroundTruthBase(SimulatedJoints):
    """A simulated base that also returns the true motion of the robot.

    The true motion of the robot is used only for measurements.  The base driver uses only the
    methods of ``BaseHandle``.
    """

    @abc.abstractmethod
    def true_pose(self) -> Pose2:
        """Returns the planar pose of ``base_link`` in the world frame."""

    @abc.abstractmethod
    def true_twist(self) -> Twist:
        """Returns the planar velocity of ``base_link``, expressed in ``base_link``."""

    def posture(self) -> tuple[float, float, float]:
        """Returns the height (m), roll (rad) and pitch (rad) of ``base_link``.

        The height of ``base_link`` is measured from the ground plane.
        """
        return 0.0, 0.0, 0.0

    def uprightness(self) -> float:
        """Returns the cosine of the tilt angle of the robot.

        The cosine of the tilt angle is 1 for an upright robot and 0 for a robot that lies on its
        side.
        """
        return 1.0

    def leaning(self) -> str:
        """Returns the direction in which the robot leans, such as `to its left`.

        Returns an empty text if the direction in which the robot leans is unknown.
        """
        return ""
