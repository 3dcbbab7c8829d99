"""Reads the sensors of a node ``/rover`` with MuJoCo: names, types, frames, rates, covariances."""

from __future__ import annotations

import itertools
import math
from typing import Any

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Imu, LaserScan, NavSatFix, PointCloud2

from tests.ros.client import Client

RELIABLE = 10
"""Depth; the default of a subscription is a reliable one."""
TOPICS = {
    "lidar/scan": (LaserScan, qos_profile_sensor_data, "rover/lidar_laser", 25.0),
    "tower/points": (PointCloud2, qos_profile_sensor_data, "rover/tower_laser", 10.0),
    "imu/data": (Imu, qos_profile_sensor_data, "rover/imu_imu", 100.0),
    "gnss/fix": (NavSatFix, RELIABLE, "rover/gnss_antenna", 10.0),
    "camera/camera_info": (CameraInfo, RELIABLE, "rover/camera_optical", 30.0),
}


def main() -> None:
    client = Client("/rover", stamped=True)
    received: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
    for topic, (kind, qos, _, _) in TOPICS.items():
        keep = received[topic].append
        client.node.create_subscription(kind, f"/rover/{topic}", keep, qos)
    client.wait("measurements", lambda: min(map(len, received.values())) > 20)
    for topic, (_, _, frame, rate) in TOPICS.items():
        messages = received[topic]
        assert {m.header.frame_id for m in messages} == {frame}, topic
        stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages]
        assert stamps == sorted(set(stamps)), topic
        periods = sorted(b - a for a, b in itertools.pairwise(stamps))
        # A step of the physics is 5 ms; a busy computer may lose messages.
        assert abs(periods[len(periods) // 2] - 1.0 / rate) < 0.0051, (topic, periods)
    scan = received["lidar/scan"][-1]
    angles = scan.angle_max - scan.angle_min
    assert len(scan.ranges) == round(angles / scan.angle_increment) + 1 == 541
    assert scan.range_max == 25.0
    # The wall at x = 4 m, before the lidar at x = 0.476 m; nothing behind.
    assert abs(scan.ranges[270] - 3.524) < 0.06
    assert math.isinf(scan.ranges[0])
    cloud = received["tower/points"][-1]
    assert [f.name for f in cloud.fields] == ["x", "y", "z"]
    assert len(cloud.data) == cloud.width * cloud.point_step > 0
    imu = received["imu/data"][-1]
    assert imu.orientation_covariance[0] > 0.0
    assert imu.angular_velocity_covariance[8] > 0.0
    assert abs(imu.linear_acceleration.z - 9.81) < 0.5
    fix = received["gnss/fix"][-1]
    assert abs(fix.latitude - 59.665) < 1e-4
    assert abs(fix.position_covariance[0] - 1e-4) < 1e-9
    info = received["camera/camera_info"][-1]
    assert (info.width, info.height) == (1280, 720)
    assert info.k[2] == 640.0
    assert client.node.count_publishers("/rover/camera/image_raw") == 1


if __name__ == "__main__":
    main()
