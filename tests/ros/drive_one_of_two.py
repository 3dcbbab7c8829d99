"""Drives ``/r1`` of two robots in one process; ``/r2`` must not move."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data

from tests.ros.client import Client


def main() -> None:
    client = Client("/r1")
    other: list[float] = []
    client.node.create_subscription(
        Odometry,
        "/r2/odometry/base_raw",
        lambda message: other.append(message.twist.twist.linear.x),
        qos_profile_sensor_data,
    )
    client.wait("odometry of both", lambda: other and "base_raw" in client.last)
    client.arm()
    client.drive(0.3)
    assert max(map(abs, other)) == 0.0
    # Commands of one robot do not reach the other, which is not armed either.
    assert max(client.keep(0.3, 0.3)) > 0.2
    assert max(map(abs, other)) == 0.0


if __name__ == "__main__":
    main()
