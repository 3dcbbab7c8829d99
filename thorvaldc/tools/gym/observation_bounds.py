"""Bounds of the observations of a Gymnasium environment, from the limits of the robot."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thorvaldc.model import Robot
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.se2 import Pose2
from thorvaldc.tools.gym.joint_actions import JointActions

SPEED_MARGIN = 1.5
"""Largest wheel speed, as a multiple of the largest speed of its motor.

Wheels that work against each other drag a wheel beyond the speed of its motor.
"""
ANGLE_MARGIN = 0.1
"""Largest steering angle beyond a steering limit, rad."""


def observation_bounds(
    robot: Robot, joints: JointActions, start: Pose2, spread: Sequence[float], duration: float
) -> NDArray[np.float64]:
    """Returns the largest absolute value of each observation, in SI units.

    - ``start``: start pose of the robot in the scene.
    - ``spread``: largest random offset of the start pose, in m, m and rad.
    - ``duration``: duration of an episode, s.

    The twist about the centroid of the wheels is a least-squares fit to wheel speeds of at most V
    m/s.  Its velocity is at most V, and its yaw rate at most V / L, where L is the root mean square
    distance of the wheels from the centroid.  The pose is bounded by the twist and the duration.
    Joints that contradict each other can give a larger estimated twist, which has no meaning.
    """
    geometry = BaseGeometry.from_robot(robot)
    radii = [robot.wheels[i].radius for i, _ in joints.driven]
    speeds = [SPEED_MARGIN * speed for _, speed in joints.driven]
    largest = max((r * speed for r, speed in zip(radii, speeds, strict=True)), default=1.0)
    turning = largest / geometry.length
    linear = largest + turning * math.hypot(*geometry.centre)
    distance = math.hypot(spread[0], spread[1]) + linear * duration
    angles = []
    for i, _, lower, upper in joints.steered:
        limit = max(abs(lower), abs(upper)) + ANGLE_MARGIN
        if not math.isfinite(limit):
            limit = math.pi + geometry.wheels[i].max_rate * duration
        angles.append(limit)
    return np.array(
        [
            *(linear, linear, turning),
            *(abs(start.x) + distance, abs(start.y) + distance),
            abs(start.yaw) + spread[2] + turning * duration,
            *speeds,
            *angles,
        ]
    )
