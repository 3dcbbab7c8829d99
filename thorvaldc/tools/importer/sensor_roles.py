"""Recognises sensors by the ``<gazebo>`` elements of a description and the names of its links."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from thorvaldc.compiler.extras.plugin_facts import numbers, walk
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Report
from thorvaldc.tools.importer.foreign_robot import ForeignRobot
from thorvaldc.tools.importer.robot_text import Value, angle

_NAMES = {
    "lidar_2d": r"laser|lidar|lds|scan|scanner|rplidar|hokuyo|sick",
    "lidar_3d": r"velodyne|vlp16|ouster|livox|lidar_3d",
    "imu": r"imu",
    "camera": r"camera|cam|realsense|zed|oakd|kinect",
    "gnss": r"gps|gnss",
}
_PATTERNS = {k: re.compile(rf"(?i)(^|_)({words})\d*(_|$)") for k, words in _NAMES.items()}
_CARRIER = re.compile(r"(?i)mount|bracket|plate|screw|holder|support|stand|cable|cover|button|body")
_GAZEBO = {
    **dict.fromkeys(("ray", "gpu_ray", "lidar", "gpu_lidar"), "lidar_2d"),
    **dict.fromkeys(
        ("camera", "rgbd_camera", "depth", "depth_camera", "wideanglecamera"), "camera"
    ),
    "imu": "imu",
    "gps": "gnss",
    "navsat": "gnss",
}


class Sensor(NamedTuple):
    """A sensor: its type, the link in which it measures, and its stated properties."""

    type: str
    link: str
    properties: dict[str, Value]


def find_sensors(robot: ForeignRobot, report: Report) -> dict[str, Sensor]:
    """Returns the sensors by the name of the link that carries each, which a joint fixes."""
    description = robot.description
    above = {joint.child: joint for joint in description.joints.values()}
    sensors: dict[str, Sensor] = {}

    def carrier(link: str, kind: str) -> str:
        """Returns the uppermost link of a sensor, by the names of the links above."""
        joint = above.get(link)
        while joint is not None and joint.type == "fixed" and _kind(joint.parent) == kind:
            link = joint.parent
            joint = above.get(link)
        return link

    for reference, element in _gazebo_sensors(robot):
        stated = element.attributes.get("type", "")
        kind = _GAZEBO.get(stated, "")
        joint = above.get(reference)
        if not kind or joint is None or joint.type != "fixed":
            what = f"the sensor of the type `{stated}` at link `{reference}`"
            report.add("import-left-out", f"{what} is not imported", element.span)
            continue
        kind, properties = _numbers(kind, element)
        top = carrier(reference, _kind(reference) or kind)
        joint = above.get(top)
        if top in sensors or joint is None or joint.type != "fixed":
            what = f"the sensor of the type `{stated}` at link `{reference}`"
            text = f"{what} is not imported: a module has one sensor"
            report.add("import-left-out", text, element.span)
            continue
        sensors[top] = Sensor(kind, reference, properties)
    inside = {inner for top in sensors for inner in description.rigid_part(top)}
    for link in description.links:
        joint = above.get(link)
        kind = _kind(link)
        if kind and link not in inside and joint is not None and joint.type == "fixed":
            sensors[link] = Sensor(kind, link, {})
            inside |= {*description.rigid_part(link)}
    return sensors


def _kind(link: str) -> str:
    if _CARRIER.search(link):
        return ""
    return next((kind for kind, words in _PATTERNS.items() if words.search(link)), "")


def _gazebo_sensors(robot: ForeignRobot) -> list[tuple[str, Element]]:
    return [
        (element.attributes.get("reference", ""), sensor)
        for element in robot.elements
        if element.tag == "gazebo"
        for sensor in walk(element)
        if sensor.tag == "sensor"
    ]


def _numbers(kind: str, sensor: Element) -> tuple[str, dict[str, Value]]:
    """Returns the type and the properties of a sensor of Gazebo that are numbers in its range."""
    texts: dict[str, float] = {}
    for outer in walk(sensor):
        for element in outer.children:
            value = numbers(element.text, 1)
            if value is not None:
                texts.setdefault(f"{outer.tag}/{element.tag}", value[0])
    properties: dict[str, Value] = {}

    def keep(name: str, value: float | None, least: float, most: float) -> None:
        if value is not None and least < value <= most:
            angle_names = ("field_of_view", "horizontal_field_of_view", "angular_resolution")
            properties[name] = angle(value) if name in angle_names else value
            if name in _WHOLE:
                properties[name] = round(value)

    keep("rate", texts.get("sensor/update_rate"), 0.0, 1e6)
    if kind == "lidar_2d":
        if texts.get("vertical/samples", 1.0) > 1.0:
            kind = "lidar_3d"
            keep("layers", texts.get("vertical/samples"), 1.5, 1024.0)
        keep("range", texts.get("range/max"), 0.0, 1e4)
        keep("minimum_range", texts.get("range/min"), 0.0, texts.get("range/max", 0.0))
        low, high = texts.get("horizontal/min_angle", 0.0), texts.get("horizontal/max_angle", 0.0)
        turn = min(high - low, math.tau)
        turn = math.tau if turn > math.tau - 1e-3 else turn  # 6.28 in many files
        keep("field_of_view", turn, 0.0, math.tau)
        rays = texts.get("horizontal/samples", 0.0)
        if rays > 1.0:
            keep("angular_resolution", turn / (rays - 1.0), math.radians(0.01), turn)
    elif kind == "camera":
        keep("horizontal_field_of_view", texts.get("camera/horizontal_fov"), 0.0, 3.12)
        keep("image_width", texts.get("image/width"), 0.5, 65535.0)
        keep("image_height", texts.get("image/height"), 0.5, 65535.0)
    return kind, properties


_WHOLE = ("layers", "image_width", "image_height")
