"""Settings of the ROS 2 package of a robot, and the names that ROS 2 and the package reserve."""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass

from thorvaldc.model.element import Element

DISTROS = ("jazzy", "kilted", "lyrical")
"""Distributions of ROS 2 for which packages are written, oldest first."""
DRIVER, EKF = "driver", "ekf"
"""Values of ``RosSettings.odom_tf``."""
MEASURED, FOR_FILTERS = "measured", "for_filters"
"""Values of the parameter ``twist_covariance`` of the base driver."""
ODOM_FRAME, MAP_FRAME = "odom", "map"
"""Frames that the nodes of the package add to those of the robot's links."""
RESERVED_TOPICS = {
    "odometry/base_raw": "the odometry of the base driver",
    "odometry/filtered": "the output of the EKF",
    "odometry/filtered_map": "the output of the EKF with GNSS",
    "odometry/gps": "the output of navsat_transform",
    "joint_states": "the joint states",
    "battery_data": "the state of the batteries",
    "can_frames_device_r": "the frames from foreign devices",
    "can_frames_device_t": "the frames to foreign devices",
    "robot_description": "the URDF",
    "cmd_vel_nav": "the output of the controllers of Nav2",
    "cmd_vel_smoothed": "the output of the velocity smoother",
    "tf": "the transforms",
    "tf_static": "the transforms",
    "clock": "the simulated time",
}
"""Topics of the package in the name space of the robot, with their content. No source and no lock
of twists may have one of these topics."""


# Python packages that the nodes and launch files of a ROS 2 package import, and folders of the
# package.  The Python package of a ROS 2 package with such a name would hide or be one of them.
_TAKEN = frozenset(
    ["ament_index_python", "can", "launch", "launch_ros", "mujoco", "numpy", "rclpy", "setuptools"]
    + ["std_srvs", "test", "tests", "thorvaldc", "xacro", "yaml"]
    + [f"{kind}_msgs" for kind in ("diagnostic", "geometry", "nav", "sensor", "std", "tf2")]
    + ["build", "config", "install", "log", "meshes", "mjcf", "resource", "rviz", "sdf", "urdf"]
)
# The names that REP 144 and the ROS 2 build tools allow; two or more characters.
_PACKAGE = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


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


def package_name(text: str) -> str:
    """Return an allowed name of a ROS 2 package that is similar to a text.

    An allowed name of a ROS 2 package does not change.
    """
    words = [word for word in re.split(r"[^a-z0-9]+", text.lower()) if word]
    name = "_".join(words)
    if not name[:1].isalpha():
        name = f"robot_{name}".rstrip("_")
    return name if package_problem(name) is None else f"{name}_robot"


def package_problem(name: str) -> str | None:
    """Return why a ROS 2 package cannot have a name, or ``None`` if it can."""
    if not _PACKAGE.fullmatch(name) or len(name) < 2:
        return (
            "expected two or more lower-case letters, digits and single `_`, with a letter first"
            " and no `_` last"
        )
    if keyword.iskeyword(name) or keyword.issoftkeyword(name):
        return "it is a keyword of Python"
    if name in _TAKEN:
        return f"a Python package or a folder of the package is called `{name}`"
    return None
