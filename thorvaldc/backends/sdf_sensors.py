"""The sensors of an SDF model."""

from __future__ import annotations

import math
from collections.abc import Mapping

from thorvaldc.backends.gazebo_topics import sensor_topics
from thorvaldc.backends.sdf_elements import add_pose
from thorvaldc.backends.xml_writer import Element, number
from thorvaldc.model import Pose, Scalar, Sensor
from thorvaldc.model.spatial import clean

SENSORS = {
    "lidar_2d": "gpu_lidar",
    "lidar_3d": "gpu_lidar",
    "imu": "imu",
    "gnss": "navsat",
    "camera": "camera",
}
"""Sensor types of SDF by the sensor types of the model; other sensors have no counterpart."""
CAMERA = Pose.from_xyz_rpy((0.0, 0.0, 0.0), (0.0, -math.pi / 2, math.pi / 2))
"""The frame of an SDF camera in the optical frame: an SDF camera looks along x with z up, the
optical frame looks along z with y down."""

Values = Mapping[str, Scalar]


def add_sensor(link: Element, sensor: Sensor, pose: Pose, prefix: str) -> None:
    """Add a sensor to an SDF link. ``pose`` is the pose of the measurement frame in the link.

    ``gazebo_topics`` has the topics of the sensor. A sensor of a type without a counterpart in SDF
    is left out.
    """
    kind = SENSORS.get(sensor.type)
    if kind is None:
        return
    values = dict(sensor.properties)
    element = link.add("sensor", name=prefix + sensor.name, type=kind)
    add_pose(element, pose * CAMERA if kind == "camera" else pose)
    element.add("always_on").text = "true"
    element.add("update_rate").text = number(_number(values, "rate", 10.0))
    first, *others = (prefix + topic for topic, _, _ in sensor_topics(sensor))
    # A lidar publishes scans on its topic, and points on the topic ``points`` below it.
    element.add("topic").text = first.removesuffix("/points")
    element.add("gz_frame_id").text = prefix + sensor.link
    if kind == "camera":
        _add_camera(element, values, others[0])
    elif kind == "gpu_lidar":
        _add_lidar(element, values, sensor.type)
    elif kind == "imu":
        _add_imu(element, values)
    else:
        _add_navsat(element, values)


def _number(values: Values, name: str, default: float) -> float:
    value = values.get(name, default)
    return default if isinstance(value, str) else float(value)


def _add_lidar(element: Element, values: Values, kind: str) -> None:
    lidar = element.add("lidar")
    scan = lidar.add("scan")
    width = _number(values, "field_of_view", math.tau)
    step = _number(values, "angular_resolution", math.radians(1.0))
    _add_scan(scan.add("horizontal"), width, max(2, round(width / step) + 1))
    if kind == "lidar_3d":
        height = _number(values, "vertical_field_of_view", math.radians(30.0))
        _add_scan(scan.add("vertical"), height, int(_number(values, "layers", 16)))
    distances = lidar.add("range")
    distances.add("min").text = number(_number(values, "minimum_range", 0.05))
    distances.add("max").text = number(_number(values, "range", 30.0))


def _add_scan(element: Element, angle: float, samples: int) -> None:
    element.add("samples").text = number(samples)
    element.add("min_angle").text = number(clean(-angle / 2))
    element.add("max_angle").text = number(clean(angle / 2))


def _add_camera(element: Element, values: Values, info_topic: str) -> None:
    camera = element.add("camera")
    camera.add("camera_info_topic").text = info_topic
    angle = _number(values, "horizontal_field_of_view", math.radians(69.0))
    camera.add("horizontal_fov").text = number(angle)
    image = camera.add("image")
    image.add("width").text = number(int(_number(values, "image_width", 1280)))
    image.add("height").text = number(int(_number(values, "image_height", 720)))
    clip = camera.add("clip")
    clip.add("near").text = "0.05"
    clip.add("far").text = "100"


def _add_imu(element: Element, values: Values) -> None:
    """Add an IMU. A noise density d gives the standard deviation d sqrt(rate) of a sample."""
    imu = element.add("imu")
    samples = math.sqrt(_number(values, "rate", 100.0))
    for group, name in (
        ("angular_velocity", "gyro_noise"),
        ("linear_acceleration", "accelerometer_noise"),
    ):
        deviation = clean(_number(values, name, 0.0) * samples)
        if deviation:
            part = imu.add(group)
            for axis in "xyz":
                _add_noise(part.add(axis), deviation)


def _add_navsat(element: Element, values: Values) -> None:
    deviation = _number(values, "accuracy", 0.0)
    if deviation:
        sensing = element.add("navsat").add("position_sensing")
        for axis in ("horizontal", "vertical"):
            _add_noise(sensing.add(axis), deviation)


def _add_noise(element: Element, deviation: float) -> None:
    noise = element.add("noise", type="gaussian")
    noise.add("mean").text = "0"
    noise.add("stddev").text = number(deviation)
