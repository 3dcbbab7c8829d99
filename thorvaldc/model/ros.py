"""Settings of the ROS 2 package of a robot, and the names that ROS 2 and the package reserve."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.element import Element

DISTROS = ("jazzy", "kilted", "lyrical")
"""Distributions of ROS 2 for which packages are written, oldest first."""
DRIVER, EKF = "driver", "ekf"
"""Values of ``RosSettings.odom_tf``."""
ODOM_FRAME, MAP_FRAME = "odom", "map"
"""Frames that the nodes of the package add to those of the robot's links."""
RESERVED_TOPICS = {
    "odometry/base_raw": "the odometry of the base driver",
    "odometry/filtered": "the output of the EKF",
    "odometry/gps": "the output of navsat_transform",
    "joint_states": "the joint states",
    "battery_data": "the state of the batteries",
    "can_frames_device_r": "the frames from foreign devices",
    "can_frames_device_t": "the frames to foreign devices",
    "robot_description": "the URDF",
    "cmd_vel": "the output of the controllers of Nav2",
    "cmd_vel_smoothed": "the output of the velocity smoother",
    "tf": "the transforms",
    "tf_static": "the transforms",
    "clock": "the simulated time",
}
"""Topics of the package in the name space of the robot, with their content. No source and no lock
of twists may have one of these topics."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RosSettings(Element):
    """Settings of the ROS 2 package of the robot.

    - ``distro``: distribution of ROS 2 that the package is for, one of ``DISTROS``.
    - ``odom_tf``: the one node that publishes the transform from ``odom`` to ``base_link``:
      ``driver``, the base driver, or ``ekf``, the EKF of robot_localization.
    - ``package``: name of the ROS 2 package. Every robot of a fleet has its own package.
    """

    distro: str = DISTROS[0]
    odom_tf: str = DRIVER
    package: str = "robot"

    @property
    def stamped(self) -> bool:
        """True if twists are messages of the type TwistStamped, false for the type Twist."""
        return self.distro != "jazzy"


DEFAULT_SETTINGS = RosSettings()
"""Settings of a robot whose file has no section `ros`, except for the name of the package."""
