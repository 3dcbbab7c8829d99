"""Message templates give the bytes of a serialiser that encodes the whole message."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from thorvaldc.simulation.records.mcap_writer import (
    joints_template,
    odometry_template,
    transforms_template,
    twist_template,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
TIME = 12_000_000_034
# Lengths of 1 to 8 bytes: every padding occurs.
NAMES = ["", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg"]


def message(type_name: str, *values: Any) -> Any:
    return STORE.types[type_name](*values)


def header(frame: str) -> Any:
    return message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", 12, 34), frame)


def vector(kind: str, *values: float) -> Any:
    return message(f"geometry_msgs/msg/{kind}", *values)


def encoded(type_name: str, *values: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message(type_name, *values), type_name))


@pytest.mark.parametrize("name", NAMES)
def test_twist(name: str) -> None:
    numbers = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    twist = message(
        "geometry_msgs/msg/Twist", vector("Vector3", *numbers[:3]), vector("Vector3", *numbers[3:])
    )
    expected = encoded("geometry_msgs/msg/TwistStamped", header(name), twist)
    assert twist_template(name).encode(TIME, numbers) == expected


@pytest.mark.parametrize("name", NAMES)
def test_odometry(name: str) -> None:
    numbers = [k / 7.0 for k in range(85)]
    pose = message(
        "geometry_msgs/msg/Pose", vector("Point", *numbers[:3]), vector("Quaternion", *numbers[3:7])
    )
    twist = message(
        "geometry_msgs/msg/Twist",
        vector("Vector3", *numbers[43:46]),
        vector("Vector3", *numbers[46:49]),
    )
    expected = encoded(
        "nav_msgs/msg/Odometry",
        header("odom"),
        name,
        message("geometry_msgs/msg/PoseWithCovariance", pose, np.array(numbers[7:43])),
        message("geometry_msgs/msg/TwistWithCovariance", twist, np.array(numbers[49:])),
    )
    assert odometry_template("odom", name).encode(TIME, numbers) == expected


@pytest.mark.parametrize("count", [0, 1, 2])
def test_transforms(count: int) -> None:
    frames = [(NAMES[k + 1], NAMES[k + 4]) for k in range(count)]
    numbers = [float(k) for k in range(7 * count)]
    transforms = [
        message(
            "geometry_msgs/msg/TransformStamped",
            header(parent),
            child,
            message(
                "geometry_msgs/msg/Transform",
                vector("Vector3", *numbers[7 * k : 7 * k + 3]),
                vector("Quaternion", *numbers[7 * k + 3 : 7 * k + 7]),
            ),
        )
        for k, (parent, child) in enumerate(frames)
    ]
    expected = encoded("tf2_msgs/msg/TFMessage", transforms)
    assert transforms_template(frames).encode(TIME, numbers) == expected


@pytest.mark.parametrize("count", range(len(NAMES)))
def test_joints(count: int) -> None:
    names = NAMES[:count]
    positions, velocities = np.arange(count) + 0.5, np.arange(count) - 0.5
    expected = encoded(
        "sensor_msgs/msg/JointState", header(""), names, positions, velocities, np.array([])
    )
    numbers = [*positions.tolist(), *velocities.tolist()]
    assert joints_template(names).encode(TIME, numbers) == expected
