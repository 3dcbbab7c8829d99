"""ROS 2 parameters of base driver, multiplexer, teleoperation, robot_state_publisher and
localization, and the files of parameters.

The page docs/ros2.md describes each ROS 2 parameter.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence

from thorvaldc.backends import ros2_parts
from thorvaldc.model import Robot, Sensor
from thorvaldc.model.settings import DRIVER, FOR_FILTERS

Scalar = bool | int | float | str
Value = Scalar | Sequence[Scalar] | Mapping[str, "Value"]
Parameters = dict[str, Value]

HEADER = "# Made by thorvaldc from the robot's file; changes here are lost.\n"

FILTER_NOISE = """\
# An EKF takes the errors of twists as independent, and those of wheels last. The pose of the filter
# has the right covariance if the robot file says how long, in the section `driver`:
#   all may last for the whole drive (default):
#     noise: {}
#   some seconds, such as those of ground and tyres:
#     noise: {correlation: 2 s, radius_error: 0, steering_offset_error: 0}
#   independent, such as those of encoders:
#     noise: {correlation: 0, radius_error: 0, steering_offset_error: 0}
#   a third of the variance of each kind:
#     noise: {correlation: 1 s, radius_error: 0.58 %, steering_offset_error: 0.29 deg}
# `thorvaldc calibrate` measures these values. No EKF describes yaw errors much above 0.1 rad:
# a robot that drifts more between two other measurements of its pose needs a gyro or calibrated
# wheels (`radius_error: 0.1 %`).
"""
"""Comment about the covariance of the twists in the file of the base driver."""

HEADING = """\
# The yaw of the IMU must be 0 towards east. If it is 0 towards north, yaw_offset is pi/2; if it is
# relative to magnetic north, magnetic_declination_radians is the declination at the place of work.
"""
"""Comment about the heading in the file of the localization by GNSS."""

_NODE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*/?[A-Za-z_][A-Za-z0-9_]*")
_PLAIN_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# Words that some YAML readers read as a truth value, a number or null instead of text.
_WORDS = frozenset(
    ["y", "n", "yes", "no", "on", "off", "true", "false", "null", "nan", "inf", "infinity"]
)
# Characters that end a line or are forbidden in YAML, and that a JSON encoder does not escape.
_UNSAFE = re.compile("[\x7f-\xa0\u2028\u2029\ufeff\ufffe\uffff]")
_INT64 = 1 << 63
TELEOP_SHARE = 0.5  # speed without the turbo button, as a fraction of the robot's limits


def base_driver(robot: Robot, parts: ros2_parts.Parts) -> Parameters:
    """Return the ROS 2 parameters of the base driver.

    The launch files set the base, the bus and the path of the model file. The base driver reads
    everything else from the model file.
    """
    # An EKF takes the errors of the twists as independent.
    covariance = {"twist_covariance": FOR_FILTERS} if parts.localization else {}
    return {
        "stamped": robot.ros.stamped,
        "enable_odom_tf": robot.ros.odom_tf == DRIVER,
        "publish_description": False,  # robot_state_publisher publishes it
        "autostart": True,
        **covariance,
    }


def twist_mux(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of twist_mux: the twist sources and the stop locks of the robot.

    Only robots that the controllers of ros2_control drive need the node twist_mux. These
    controllers take stamped twists in every distribution. The parameters of twist_mux contain no
    empty lists.
    """
    lists = {"topics": robot.twist_sources, "locks": robot.twist_locks}
    parameters: Parameters = {"use_stamped": True}
    for key, inputs in lists.items():
        if inputs:
            parameters[key] = {
                i.name: {"topic": i.topic, "timeout": i.timeout, "priority": i.priority}
                for i in inputs
            }
    return parameters


def is_holonomic(robot: Robot) -> bool:
    """Return whether the robot can move sideways: every wheel can steer or swivel."""
    turns = [wheel.steered or wheel.swivel_joint is not None for wheel in robot.wheels]
    return bool(turns) and all(turns)


def teleop(robot: Robot, stamped: bool) -> Parameters:
    """Return the ROS 2 parameters of teleop_twist_joy.

    The axes and buttons are those of the node ``game_controller_node``, which has one layout for
    all pads. The scales of the axes come from the velocity limits of the robot. Pads of every make
    have the buttons for the enabling switch, the upper left and right shoulder buttons.

    ``stamped`` is true for twists of the type TwistStamped.
    """
    linear, angular = robot.driver.max_linear_velocity, robot.driver.max_angular_velocity
    sideways = linear if is_holonomic(robot) else 0.0

    def scales(share: float) -> tuple[dict[str, float], dict[str, float]]:
        return {"x": share * linear, "y": share * sideways}, {"yaw": share * angular}

    slow, fast = scales(TELEOP_SHARE), scales(1.0)
    return {
        "publish_stamped_twist": stamped,
        "frame": ros2_parts.base_frame(robot),
        "require_enable_button": True,
        "enable_button": 9,
        "enable_turbo_button": 10,
        "inverted_reverse": False,
        "axis_linear": {"x": 1, "y": 0},
        "axis_angular": {"yaw": 2},
        "scale_linear": slow[0],
        "scale_linear_turbo": fast[0],
        "scale_angular": slow[1],
        "scale_angular_turbo": fast[1],
    }


def game_controller(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of the node that reads the pad.

    The node repeats the state of the pad often enough that the source does not time out.
    """
    source = next((s for s in robot.twist_sources if s.name == "teleop_joy"), None)
    timeout = source.timeout if source is not None else robot.driver.command_timeout
    return {"deadzone": 0.1, "autorepeat_rate": min(max(20.0, 5.0 / timeout), 1000.0)}


def robot_state_publisher(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of robot_state_publisher.

    The parameter ``frame_prefix`` is empty, because the names in the URDF already begin with the
    name space of the robot. The launch file reads the URDF.
    """
    return {
        "frame_prefix": "",
        "publish_frequency": robot.driver.rate,
        "ignore_timestamp": False,
    }


def aggregator(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of diagnostic_aggregator: the statuses of the base driver in
    groups, of which those that every base publishes are expected, and those of the sensors.

    A status is in each group that matches its name. A regular expression has to match the whole
    name, so that `battery` does not match `battery_lift_controller`; the names have no character
    with a meaning in one. Drivers of sensors begin their statuses with the names of their nodes.
    """
    motors = dict.fromkeys(a.node for a in robot.actuators if a.node is not None)
    batteries = [battery.name for battery in robot.batteries]
    groups = {
        "base_driver": ["states", "joint topics"],
        "buses": [f"bus {bus.name}" for bus in robot.buses],
        "motor_controllers": list(motors),
        "batteries": [*batteries, *(["supply"] if len(batteries) > 1 else [])],
    }
    start = f"{robot.prefix}base_driver: "
    expected = {"expected": [start + name for name in ("driver", "commands", "timing")]}
    analyzers: Parameters = {
        group: {
            "type": "diagnostic_aggregator/GenericAnalyzer",
            "path": group,
            "regex": [start + name for name in names],
            **(expected if group == "base_driver" else {}),
        }
        for group, names in groups.items()
        if names
    }
    drivers = [sensor for sensor in robot.sensors if sensor.ros2_driver is not None]
    if drivers:
        analyzers["sensors"] = {
            "type": "diagnostic_aggregator/GenericAnalyzer",
            "path": "sensors",
            "startswith": [f"{ros2_parts.sensor_node(sensor)}: " for sensor in drivers],
        }
    return {"path": robot.name, **analyzers}


# -- localization: robot_localization and slam_toolbox -------------------------------------
#
# robot_localization takes the covariances of its inputs from the messages: those of the odometry
# are estimated by the base driver, whose parameter `twist_covariance` is `for_filters`. Two
# filters can run:
#
# - ``ekf_odom`` fuses odometry and IMU, and publishes the transform from ``odom`` to ``base_link``,
#   if the robot file says ``odom_tf: ekf``;
# - ``ekf_map`` fuses odometry, IMU and GNSS, and publishes the transform from ``map`` to ``odom``.

# The state of an EKF, in the order of robot_localization: position, orientation, velocity,
# angular velocity, acceleration, each with x, y and z. An input measures a part of it.
_VX, _VY, _YAW_RATE, _YAW, _X, _Y = 6, 7, 11, 5, 0, 1


def _inputs(*used: int) -> list[bool]:
    return [k in used for k in range(15)]


def ekf_odom(robot: Robot, parts: ros2_parts.Parts) -> Parameters:
    """Return the parameters of the EKF that publishes the transform from ``odom`` to
    ``base_link``."""
    return {
        **_ekf(robot, ros2_parts.odom_frame(robot)),
        **_sources(robot, parts, absolute_yaw=False),
    }


def ekf_map(robot: Robot, parts: ros2_parts.Parts) -> Parameters:
    """Return the parameters of the EKF that publishes the transform from ``map`` to ``odom``."""
    return {
        **_ekf(robot, ros2_parts.map_frame(robot)),
        **_sources(robot, parts, absolute_yaw=True),
        "odom1": ros2_parts.full_topic(robot, "odometry/gps"),
        "odom1_config": _inputs(_X, _Y),
        "odom1_differential": False,
    }


def _ekf(robot: Robot, world_frame: str) -> Parameters:
    return {
        "frequency": robot.driver.rate,
        "sensor_timeout": 2.0 / robot.driver.rate,  # one message may be late
        "two_d_mode": True,
        "publish_tf": True,
        "map_frame": ros2_parts.map_frame(robot),
        "odom_frame": ros2_parts.odom_frame(robot),
        "base_link_frame": ros2_parts.base_frame(robot),
        "world_frame": world_frame,
        "process_noise_covariance": process_noise(robot),
    }


def process_noise(robot: Robot) -> list[float]:
    """Return the diagonal of the process noise of an EKF: its growth per second.

    The filter takes the accelerations as white, and the driver's last as long as a ramp: from the
    largest velocity v to rest with the deceleration a, t = v/a. White noise whose sum has the same
    variance has the intensity 2 a^2 t = 2 a v (``thorvaldc.runtime.odometry`` derives the
    factor 2 t). The filter then follows each ramp, and still weighs odometry against an IMU by
    their covariances.

    All other values are 0. The pose changes only by the velocity, whose errors the twist's
    covariance has. Nothing measures the accelerations, which stay 0. `two_d_mode` keeps height,
    roll and pitch at 0.
    """
    driver = robot.driver
    linear = max(driver.max_linear_acceleration, driver.max_linear_deceleration)
    angular = max(driver.max_angular_acceleration, driver.max_angular_deceleration)
    linear *= 2.0 * driver.max_linear_velocity
    angular *= 2.0 * driver.max_angular_velocity
    growth = {_VX: linear, _VY: linear, _YAW_RATE: angular}
    return [growth.get(k, 0.0) for k in range(15)]


def _sources(robot: Robot, parts: ros2_parts.Parts, *, absolute_yaw: bool) -> Parameters:
    """Return the parameters of the inputs that both filters have.

    A filter ignores the orientation of an IMU that marks it as unknown (REP 145).
    """
    values: Parameters = {
        "odom0": ros2_parts.full_topic(robot, "odometry/base_raw"),
        "odom0_config": _inputs(_VX, _VY, _YAW_RATE),
        "odom0_differential": False,
    }
    if parts.imu is not None:
        used = (_YAW, _YAW_RATE) if absolute_yaw else (_YAW_RATE,)
        values |= {
            "imu0": ros2_parts.sensor_topic(robot, parts.imu),
            "imu0_config": _inputs(*used),
            "imu0_differential": False,
        }
    return values


def navsat_transform(robot: Robot, parts: ros2_parts.Parts) -> Parameters:
    """Return the parameters of the node that converts GNSS positions to the frame ``map``."""
    return {
        "frequency": robot.driver.rate,
        "zero_altitude": True,
        "publish_filtered_gps": True,
        "use_odometry_yaw": parts.imu is None,
        "wait_for_datum": False,
        "magnetic_declination_radians": 0.0,
        "yaw_offset": 0.0,
    }


def slam_toolbox(robot: Robot, lidar: Sensor) -> Parameters:
    """Return the parameters of slam_toolbox, which makes a map with a 2d lidar and publishes the
    transform from ``map`` to ``odom``."""
    properties = dict(lidar.properties)
    values: Parameters = {
        "map_frame": ros2_parts.map_frame(robot),
        "odom_frame": ros2_parts.odom_frame(robot),
        "base_frame": ros2_parts.base_frame(robot),
        "scan_topic": ros2_parts.sensor_topic(robot, lidar),
        "map_name": ros2_parts.full_topic(robot, "map"),
        "resolution": 0.05,
        "map_update_interval": 2.0,
        "transform_publish_period": 1.0 / robot.driver.rate,
        "minimum_travel_distance": 0.3,
        "minimum_travel_heading": 0.3,
    }
    if "range" in properties:
        values["max_laser_range"] = float(properties["range"])
    return values


# -- files of parameters ---------------------------------------------------------------
#
# Every YAML reader reads them in the same way. The YAML parser of ROS 2 (rcl) rejects aliases,
# nested or mixed lists and empty values, and guesses the type of some values: ``y`` is true,
# ``017`` is 15, and ``1e3`` is a number. The writer therefore puts all text in double quotes,
# writes every float with a dot, and rejects empty lists and lists with mixed types.


class ParameterError(ValueError):
    """A value that a ROS 2 parameter file cannot contain. The error message contains the name of
    the ROS 2 parameter."""


def parameter_file(nodes: Mapping[str, Mapping[str, Value]], comment: str = "") -> str:
    """Return the text of a ROS 2 parameter file, with a comment at its start.

    ``nodes`` maps the full name of each ROS 2 node, such as ``/r1/base_driver``, to the parameters
    of the node. A nested dictionary is a group of ROS 2 parameters: ``{"a": {"b": 1}}`` is the
    parameter ``a.b``. Raises ``ParameterError`` for a value that rcl, the YAML parser of ROS 2,
    rejects or misreads.
    """
    lines = [HEADER, comment]
    for node, parameters in nodes.items():
        if not _NODE.fullmatch(node):
            raise ParameterError(f"`{node}` is no name of a ROS node")
        lines.append(f"{node}:\n  ros__parameters:\n")
        _write(lines, parameters, 2, node)
    return "".join(lines)


def _write(lines: list[str], group: Mapping[str, Value], depth: int, path_of_group: str) -> None:
    if not group:
        raise ParameterError(f"`{path_of_group}` has no parameters")
    for name, value in group.items():
        path = f"{path_of_group}.{name}"
        key = _key(name)
        if isinstance(value, Mapping):
            lines.append(f"{'  ' * depth}{key}:\n")
            _write(lines, value, depth + 1, path)
        else:
            lines.append(f"{'  ' * depth}{key}: {_value(value, path)}\n")


def _key(name: str) -> str:
    if _PLAIN_KEY.fullmatch(name) and name.lower() not in _WORDS:
        return name
    return quoted(name)


def _value(value: Value, path: str) -> str:
    if isinstance(value, str) or not isinstance(value, Sequence):
        return _scalar(value, path)
    if not value:
        raise ParameterError(f"`{path}` is an empty list, which has no type")
    if len({item.__class__ for item in value}) > 1:  # `type` tells the numbers of `why` apart
        raise ParameterError(f"`{path}` mixes types in a list")
    return f"[{', '.join(_scalar(item, path) for item in value)}]"


def _scalar(value: object, path: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        if not -_INT64 <= value < _INT64:
            raise ParameterError(f"`{path}` does not fit into 64 bits: {value}")
        return str(value)
    if isinstance(value, float):
        return real(value, path)
    if isinstance(value, str):
        return quoted(value)
    raise ParameterError(f"`{path}` is {value!r}, which is no parameter value")


def real(value: float, path: str = "value") -> str:
    """Return the shortest text with a decimal point that reads back as the same float.

    Denormal floating-point numbers become 0.0. Raises ``ParameterError`` for NaN and infinite
    numbers.
    """
    if not math.isfinite(value):
        raise ParameterError(f"`{path}` is not finite: {value}")
    if abs(value) < sys.float_info.min:  # strtod reports denormal numbers as out of range
        return "0.0"
    text = repr(value)
    mantissa, e, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{e}{exponent}"


def quoted(text: str) -> str:
    """Return the text in double quotes with JSON's escape sequences, which are also valid in
    YAML."""
    escaped = json.dumps(text, ensure_ascii=False)
    return _UNSAFE.sub(lambda match: f"\\u{ord(match[0]):04x}", escaped)
