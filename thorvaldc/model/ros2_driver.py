"""The ROS 2 driver of a sensor, as its module states it."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.bus import Scalar

RAW_IMU = ("data_raw", "mag")
"""Topics of a driver of an IMU without orientation: angular velocity and specific force, and the
magnetic field.  A filter makes the topic ``data`` of them."""


@dataclass(frozen=True, slots=True)
class Ros2Driver:
    """The node that publishes the measurements of a sensor of the real robot.

    - ``package``, ``executable``: ROS package and program of the driver.
    - ``frame``: parameter of the driver that takes the frame of the sensor.
    - ``topics``: topic of the driver for each topic of the sensor, such as ``points`` and
      ``velodyne_points``.
    - ``ports``: parameters of the driver that take a serial port, each with the name of a port of
      the robot's computer or the path of a device.
    - ``parameters``: other parameters of the driver by name, in SI units.
    """

    package: str
    executable: str
    frame: str
    topics: tuple[tuple[str, str], ...] = ()
    ports: tuple[tuple[str, str], ...] = ()
    parameters: tuple[tuple[str, Scalar], ...] = ()


def device_path(port: str) -> str:
    """Return the path of a serial port; the name of a port of the computer is one below `/dev`."""
    return port if port.startswith("/") else f"/dev/{port}"
