"""Measurements as ROS 2 messages, for the node and for records.

The messages are described by names and values, because the node and the library rosbags have
classes of their own for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from thorvaldc.simulation.sensors.camera import CameraFrame
from thorvaldc.simulation.sensors.gnss import Fix
from thorvaldc.simulation.sensors.imu import ImuReading
from thorvaldc.simulation.sensors.lidar import PointCloud, Scan
from thorvaldc.simulation.sensors.simulated_sensor import Measurement

_FLOAT32 = 7
"""Value of ``PointField.datatype`` for 32 bits."""
_DIAGONAL_KNOWN = 2
"""Value of ``NavSatFix.position_covariance_type``."""
_GROUND_BASED, _GPS = 2, 1
"""Values of ``NavSatStatus``: a fix with corrections of a base station, by the system GPS."""


class Message(NamedTuple):
    """A ROS 2 message: its type, such as ``sensor_msgs/msg/Imu``, and its fields by name.

    A field is a number, a text, a ``Message``, a list of messages, a tuple for an array of a fixed
    number of float64, or an array of numpy for a sequence of any length.
    """

    type: str
    fields: Mapping[str, Any]


def build(
    message: Message,
    class_of: Callable[[str], Any],
    sequence: Callable[[Any], Any],
    fixed: Callable[[Any], Any],
) -> Any:
    """Returns a message as an object.

    - ``class_of``: function that returns the class of a type.
    - ``sequence``, ``fixed``: functions that convert an array of numpy and a tuple.
    """

    def value(field: Any) -> Any:
        if isinstance(field, Message):
            return build(field, class_of, sequence, fixed)
        if isinstance(field, list):
            return [value(item) for item in field]
        if isinstance(field, np.ndarray):
            return sequence(field)
        return fixed(field) if isinstance(field, tuple) else field

    return class_of(message.type)(**{name: value(v) for name, v in message.fields.items()})


def messages(measurement: Measurement) -> list[Message]:
    """Returns the messages of a measurement, at most one of each type."""
    match measurement:
        case Scan():
            return [_scan(measurement)]
        case PointCloud():
            return [_cloud(measurement)]
        case ImuReading():
            return [_imu(measurement)]
        case Fix():
            return [_fix(measurement)]
        case CameraFrame():
            image = [] if measurement.pixels is None else [_image(measurement)]
            return [*image, _camera_info(measurement)]
    raise TypeError(type(measurement).__name__)


def _sensor_message(kind: str, measurement: Measurement, **fields: Any) -> Message:
    seconds, nanoseconds = divmod(round(measurement.time * 1e9), 1_000_000_000)
    stamp = Message("builtin_interfaces/msg/Time", {"sec": seconds, "nanosec": nanoseconds})
    header = Message("std_msgs/msg/Header", {"stamp": stamp, "frame_id": measurement.frame})
    return Message(f"sensor_msgs/msg/{kind}", {"header": header, **fields})


def _vector(kind: str, values: Any) -> Message:
    fields = dict(zip("xyzw", map(float, values), strict=False))
    return Message(f"geometry_msgs/msg/{kind}", fields)


def _diagonal(variance: float) -> tuple[float, ...]:
    return (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance)


def _scan(scan: Scan) -> Message:
    return _sensor_message(
        "LaserScan",
        scan,
        angle_min=scan.first_angle,
        angle_max=scan.first_angle + scan.step * (len(scan.ranges) - 1),
        angle_increment=scan.step,
        time_increment=0.0,  # all rays have the time of the stamp
        scan_time=scan.period,
        range_min=scan.nearest,
        range_max=scan.farthest,
        ranges=scan.ranges.astype(np.float32),
        intensities=np.zeros(0, np.float32),
    )


def _cloud(cloud: PointCloud) -> Message:
    fields = [
        Message(
            "sensor_msgs/msg/PointField",
            {"name": name, "offset": 4 * i, "datatype": _FLOAT32, "count": 1},
        )
        for i, name in enumerate("xyz")
    ]
    points = np.ascontiguousarray(cloud.points, np.dtype("<f4"))
    return _sensor_message(
        "PointCloud2",
        cloud,
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=points.view(np.uint8).ravel(),
        is_dense=True,
    )


def _imu(reading: ImuReading) -> Message:
    # REP 145: the covariance -1 marks an orientation that the unit does not know.
    covariance, (w, *xyz) = (-1.0, *[0.0] * 8), (1.0, 0.0, 0.0, 0.0)
    if reading.orientation is not None:
        covariance, (w, *xyz) = _diagonal(reading.orientation_variance), reading.orientation
    return _sensor_message(
        "Imu",
        reading,
        orientation=_vector("Quaternion", (*xyz, w)),
        orientation_covariance=covariance,
        angular_velocity=_vector("Vector3", reading.angular_velocity),
        angular_velocity_covariance=_diagonal(reading.angular_velocity_variance),
        linear_acceleration=_vector("Vector3", reading.acceleration),
        linear_acceleration_covariance=_diagonal(reading.acceleration_variance),
    )


def _fix(fix: Fix) -> Message:
    status = {"status": _GROUND_BASED, "service": _GPS}
    return _sensor_message(
        "NavSatFix",
        fix,
        status=Message("sensor_msgs/msg/NavSatStatus", status),
        latitude=fix.latitude,
        longitude=fix.longitude,
        altitude=fix.altitude,
        position_covariance=_diagonal(fix.variance),
        position_covariance_type=_DIAGONAL_KNOWN,
    )


def _image(frame: CameraFrame) -> Message:
    return _sensor_message(
        "Image",
        frame,
        height=frame.height,
        width=frame.width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * frame.width,
        data=np.ascontiguousarray(frame.pixels).ravel(),
    )


def _camera_info(frame: CameraFrame) -> Message:
    f, cx, cy = frame.focal_length, frame.width / 2.0, frame.height / 2.0
    whole = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return _sensor_message(
        "CameraInfo",
        frame,
        height=frame.height,
        width=frame.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=(f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0),
        r=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        p=(f, 0.0, cx, 0.0, 0.0, f, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
        binning_x=0,
        binning_y=0,
        roi=Message("sensor_msgs/msg/RegionOfInterest", whole),
    )
