"""The settings of a robot in the model: base calculator, base driver, parameter sets, sources of
twists, and the ROS 2 package with the names that ROS 2 reserves.
"""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass

from thorvaldc.diagnostics import Span
from thorvaldc.model import quantities as si
from thorvaldc.model.bus import Scalar

SAFETY_STOP = "safety_stop"
"""Name of the stop lock that every robot has."""
REQUIRED, AUTOMATIC = "required", "automatic"
"""Values of ``DriverSettings.arming``."""
ON_ARMING, AT_START = "on_arming", "at_start"
"""Values of ``DriverSettings.homing``."""
ARMING_TIMEOUT = 300.0
"""Default of ``DriverSettings.arming_timeout`` in s."""
ZERO_FIRST, RAMP_FIRST, ANY_FIRST = "zero", "ramp", "any"
"""Values of ``TwistInput.first_command``."""
RAMP_PERIOD = 0.05
"""Period in s of the steps of a ramp of Nav2; its controllers and smoother run at this rate."""
STOP_PRIORITY = 255
"""Priority of a twist lock from which on the lock is a stop lock, see ``TwistInput``."""


@dataclass(frozen=True, slots=True)
class CalculatorChoice:
    """The name of the robot's base calculator and its options. The base calculator is a plug-in
    class that computes joint commands from a twist."""

    name: str = "general"
    options: tuple[tuple[str, Scalar], ...] = ()


@dataclass(frozen=True, slots=True)
class BatterySettings:
    """Reaction of the base driver to the state of charge of the batteries on the buses.

    All shares are 0 to 1. The battery with the lowest charge determines the reaction.

    - ``warn``, ``limit``, ``stop``: states of charge below which the driver warns, limits the
      speed, and stops the robot.
    - ``arm``: state of charge below which the driver refuses to arm.
    - ``speed``: share of the limits of the twist below ``limit``.
    - ``silence``: time in s after which the driver stops the robot if a battery sends no state of
      charge.
    """

    warn: si.Share = 0.2
    limit: si.Share = 0.1
    stop: si.Share = 0.05
    arm: si.Share = 0.15
    speed: si.Share = 0.5
    silence: si.Seconds = 10.0


@dataclass(frozen=True, slots=True)
class DriverSettings:
    """Settings of the base driver of a robot.

    The robot file can set limits of the commanded twist. If the robot file sets no limits, the
    limits of the motors and modules determine the limits of the twist.

    - ``rate``: frequency of the control loop in Hz.
    - ``command_timeout``: time in s after which the driver considers a commanded twist too old.
    - ``max_linear_velocity``, ``max_angular_velocity``: limits of the twist in m/s and rad/s.
    - ``max_linear_acceleration``, ``max_angular_acceleration``: limits of the change of the twist
      in m/s^2 and rad/s^2.
    - ``max_linear_deceleration``, ``max_angular_deceleration``: decelerations in m/s^2 and rad/s^2
      with which the robot slows down and stops. No program can change them at run time.
    - ``arming``: ``required`` if the service ``arm`` must be called before the robot accepts
      motion, or ``automatic`` if it accepts motion when every source commands zero or nothing.
    - ``arming_timeout``: time in s after which the robot is disarmed if no source of twists was
      heard. It does not apply to automatic arming.
    - ``homing``: ``on_arming`` if the steering joints find their home position when the robot is
      armed, or ``at_start`` if they do as soon as the motor controllers are ready.
    - ``noise``: standard deviations for the odometry that the robot file sets, in SI units. The
      names of the standard deviations are the fields of the class ``Noise`` of the runtime.
    - ``stopping_distance``: longest distance in m in which every stop must end, or ``None``. The
      module ``stopping`` computes the distance of each kind of stop.
    - ``battery``: reaction to the state of charge of the batteries.
    """

    rate: si.Hertz
    command_timeout: si.Seconds
    max_linear_velocity: si.MetresPerSecond
    max_angular_velocity: si.RadiansPerSecond
    max_linear_acceleration: si.MetresPerSecond2
    max_angular_acceleration: si.RadiansPerSecond2
    max_linear_deceleration: si.MetresPerSecond2
    max_angular_deceleration: si.RadiansPerSecond2
    noise: tuple[tuple[str, float], ...] = ()
    stopping_distance: si.Metres | None = None
    battery: BatterySettings = BatterySettings()
    arming: str = REQUIRED
    arming_timeout: si.Seconds = ARMING_TIMEOUT
    homing: str = ON_ARMING

    @property
    def top_speeds(self) -> tuple[float, float]:
        """Linear (m/s) and angular (rad/s) limit of the twist."""
        return self.max_linear_velocity, self.max_angular_velocity

    @property
    def decelerations(self) -> tuple[float, float]:
        """Linear (m/s^2) and angular (rad/s^2) deceleration of a stop."""
        return self.max_linear_deceleration, self.max_angular_deceleration


def first_ramp_step(driver: DriverSettings) -> tuple[float, float]:
    """Return the largest first step of a ramp from rest, in m/s and rad/s.

    The velocity smoother of Nav2, as it is generated, changes a twist by this step at most.
    """
    linear, angular = driver.max_linear_acceleration, driver.max_angular_acceleration
    return RAMP_PERIOD * linear, RAMP_PERIOD * angular


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A named set of parameters that the driver can select while the robot drives.

    - ``radii``: name of the rolling radii of the wheels, or ``None`` for ``Wheel.radius``. Wheels
      that have no rolling radius with this name use ``Wheel.radius``.
    - ``driver``: settings of the robot's driver, with the changes of the parameter set.
    """

    name: str
    radii: str | None
    driver: DriverSettings
    span: Span


@dataclass(frozen=True, slots=True)
class TwistInput:
    """A source of commanded twists for the twist multiplexer, or a twist lock that blocks sources.

    The twist multiplexer sends the commands of the active twist source with the highest priority to
    the robot. An active twist lock blocks the twist sources of the same or a lower priority. The
    compiler accepts no source with the priority of a lock, so that the rule gives the same result
    as the rule of the ROS node twist_mux, which blocks lower priorities only.

    - ``topic``: name of the ROS topic in the name space of the robot.
    - ``priority``: priority of the source or lock, 1 to 255.
    - ``timeout``: time in s without a message after which a source becomes inactive and a lock
      blocks. A twist lock with the timeout 0 s never times out and keeps the state of its last
      message.
    - ``first_command``: ``zero`` if a twist source that did not drive the robot, for whatever
      reason, must command a zero twist before it moves the robot; ``ramp`` if it may also begin
      with the first step of a ramp after a silence longer than its time-out, see
      ``first_ramp_step``; or ``any`` if it may begin with any twist and resumes its motion, as in
      twist_mux. It has no meaning for a lock.
    """

    name: str
    topic: str
    priority: int
    timeout: si.Seconds
    first_command: str = ZERO_FIRST

    @property
    def is_stop_lock(self) -> bool:
        """``True`` if this twist lock blocks all sources: ``safety_stop``, and a lock of the
        priority 255.

        Other twist locks, such as ``auto_nav_pause``, block only sources up to their priority.
        """
        return self.name == SAFETY_STOP or self.priority >= STOP_PRIORITY


DISTROS = ("jazzy", "kilted", "lyrical")
"""Distributions of ROS 2 for which packages are written, oldest first."""
DRIVER, EKF = "driver", "ekf"
"""Values of ``RosSettings.odom_tf``."""
MEASURED, FOR_FILTERS = "measured", "for_filters"
"""Values of the parameter ``twist_covariance`` of the base driver."""
ODOM_FRAME, MAP_FRAME = "odom", "map"
NAME_PREFIX, NAME_SPACE = "$(var name_prefix)", "$(var namespace)"
"""Place of the prefix of all names, and of the name space, in the files of a ROS 2 package; its
launch files put in those of the robot that they start."""
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


@dataclass(frozen=True, slots=True)
class OwnLaunch:
    """A launch file that the robot file adds to the ROS 2 package: its name and its content."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class RosSettings:
    """Settings of the ROS 2 package of the robot.

    - ``distro``: distribution of ROS 2 that the package is for, one of ``DISTROS``.
    - ``odom_tf``: the one node that publishes the transform from ``odom`` to ``base_link``:
      ``driver``, the base driver, or ``ekf``, the EKF of robot_localization.
    - ``package``: name of the ROS 2 package. Every robot of a fleet has its own package.
    - ``license``: SPDX identifier of the package's licence, or an empty text.
    - ``maintainer``: person who maintains the package, ``Name <mail@example.org>``, or an empty
      text.
    - ``version``: version of the package, three numbers with points between them.
    - ``launch``: further launch files of the package, which the one of the real robot starts last.
    """

    distro: str = DISTROS[0]
    odom_tf: str = DRIVER
    package: str = "robot"
    license: str = ""
    maintainer: str = ""
    version: str = "0.0.0"
    launch: tuple[OwnLaunch, ...] = ()

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
