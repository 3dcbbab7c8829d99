"""ROS 2 parameters of the localization: robot_localization and slam_toolbox.

robot_localization takes the covariances of its inputs from the messages: those of the odometry are
estimated by the base driver, whose parameter `twist_covariance` is `for_filters`. Two filters can
run:

- ``ekf_odom`` fuses odometry and IMU, and publishes the transform from ``odom`` to ``base_link``,
  if the robot file says ``odom_tf: ekf``;
- ``ekf_map`` fuses odometry, IMU and GNSS, and publishes the transform from ``map`` to ``odom``.
"""

from __future__ import annotations

from thorvaldc.backends.ros2_parameter_file import Value
from thorvaldc.backends.ros2_parts import (
    Parts,
    base_frame,
    full_topic,
    map_frame,
    odom_frame,
    sensor_topic,
)
from thorvaldc.model import Robot, Sensor

Parameters = dict[str, Value]

# The state of an EKF, in the order of robot_localization: position, orientation, velocity,
# angular velocity, acceleration, each with x, y and z. An input measures a part of it.
_VX, _VY, _YAW_RATE, _YAW, _X, _Y = 6, 7, 11, 5, 0, 1


def _inputs(*used: int) -> list[bool]:
    return [k in used for k in range(15)]


def ekf_odom(robot: Robot, parts: Parts) -> Parameters:
    """Return the parameters of the EKF that publishes the transform from ``odom`` to
    ``base_link``."""
    return {**_ekf(robot, odom_frame(robot)), **_sources(robot, parts, absolute_yaw=False)}


def ekf_map(robot: Robot, parts: Parts) -> Parameters:
    """Return the parameters of the EKF that publishes the transform from ``map`` to ``odom``."""
    return {
        **_ekf(robot, map_frame(robot)),
        **_sources(robot, parts, absolute_yaw=True),
        "odom1": full_topic(robot, "odometry/gps"),
        "odom1_config": _inputs(_X, _Y),
        "odom1_differential": False,
    }


def _ekf(robot: Robot, world_frame: str) -> Parameters:
    return {
        "frequency": robot.driver.rate,
        "two_d_mode": True,
        "publish_tf": True,
        "map_frame": map_frame(robot),
        "odom_frame": odom_frame(robot),
        "base_link_frame": base_frame(robot),
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


def _sources(robot: Robot, parts: Parts, *, absolute_yaw: bool) -> Parameters:
    """Return the parameters of the inputs that both filters have.

    A filter ignores the orientation of an IMU that marks it as unknown (REP 145).
    """
    values: Parameters = {
        "odom0": full_topic(robot, "odometry/base_raw"),
        "odom0_config": _inputs(_VX, _VY, _YAW_RATE),
        "odom0_differential": False,
    }
    if parts.imu is not None:
        used = (_YAW, _YAW_RATE) if absolute_yaw else (_YAW_RATE,)
        values |= {
            "imu0": sensor_topic(robot, parts.imu),
            "imu0_config": _inputs(*used),
            "imu0_differential": False,
        }
    return values


def navsat_transform(robot: Robot, parts: Parts) -> Parameters:
    """Return the parameters of the node that converts GNSS positions to the frame ``map``."""
    return {
        "frequency": robot.driver.rate,
        "zero_altitude": True,
        "publish_filtered_gps": True,
        "use_odometry_yaw": parts.imu is None,
        "wait_for_datum": False,
    }


def slam_toolbox(robot: Robot, lidar: Sensor) -> Parameters:
    """Return the parameters of slam_toolbox, which makes a map with a 2d lidar and publishes the
    transform from ``map`` to ``odom``."""
    properties = dict(lidar.properties)
    values: Parameters = {
        "map_frame": map_frame(robot),
        "odom_frame": odom_frame(robot),
        "base_frame": base_frame(robot),
        "scan_topic": sensor_topic(robot, lidar),
        "map_name": full_topic(robot, "map"),
        "resolution": 0.05,
        "map_update_interval": 2.0,
        "transform_publish_period": 1.0 / robot.driver.rate,
        "minimum_travel_distance": 0.3,
        "minimum_travel_heading": 0.3,
    }
    if "range" in properties:
        values["max_laser_range"] = float(properties["range"])
    return values
