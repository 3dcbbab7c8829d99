"""The sensors that extras bring in ``<gazebo>`` elements, as sensors of an SDF model.

An extra states a sensor as Gazebo's URDF reader takes it, for a link of the robot:

    <gazebo reference="mast_top"><sensor name="scan" type="gpu_lidar"> ... </sensor></gazebo>

The sensor becomes a part of the SDF link that contains the link (``sdf_robot``, rigid groups), at
the same place.  Programs of others (``<plugin>``) are not brought: they could move joints that the
base driver owns.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.backends.xml_writer import Element, parse
from thorvaldc.model import Pose, Robot
from thorvaldc.model.spatial import clean3

RENDERING = ("sensors", "Sensors")
SYSTEMS = {
    "gpu_lidar": RENDERING,
    **{
        f"{kind}camera": RENDERING
        for kind in ("", "depth_", "rgbd_", "thermal_", "segmentation_", "boundingbox_")
    },
    "imu": ("imu", "Imu"),
    "navsat": ("navsat", "NavSat"),
    "altimeter": ("altimeter", "Altimeter"),
    "magnetometer": ("magnetometer", "Magnetometer"),
    "air_pressure": ("air-pressure", "AirPressure"),
}
"""Library and name of the system of Gazebo that a type of sensor needs."""
RENAMED = {"ray": "gpu_lidar", "gpu_ray": "gpu_lidar", "lidar": "gpu_lidar", "gps": "navsat"}
"""Types of older versions of Gazebo; their element in the sensor is renamed, too."""
_PARTS = {"ray": "lidar", "gps": "navsat"}


class ExtraSensor(NamedTuple):
    """A sensor of an extra.

    - ``link``: name of its link, without the prefix of the name space;
    - ``pose``: pose of the sensor in the link;
    - ``type``: type of SDF; a key of ``SYSTEMS``;
    - ``topic``: topic in Gazebo that the extra states, or an empty text;
    - ``parts``: the other elements of the sensor.
    """

    link: str
    name: str
    type: str
    pose: Pose
    topic: str
    parts: tuple[Element, ...]

    def topic_of(self, prefix: str) -> str:
        """Return the topic of Gazebo; ``prefix`` is that of the names of the robot."""
        return self.topic or prefix + self.name

    @property
    def has_points(self) -> bool:
        """True for a lidar with several layers, which publishes points below its topic."""
        scans = [s for p in self.parts if p.tag == "lidar" for s in p.children if s.tag == "scan"]
        return any(part.tag == "vertical" for scan in scans for part in scan.children)


def extra_sensors(robot: Robot) -> list[ExtraSensor]:
    """Return the sensors of the extras of a robot that SDF can express."""
    return [part for part in _parts(robot) if isinstance(part, ExtraSensor)]


def left_out(robot: Robot) -> list[str]:
    """Return a description of each part of the ``<gazebo>`` elements that is not in the SDF."""
    return [part for part in _parts(robot) if isinstance(part, str)]


def add_extra_sensor(link: Element, sensor: ExtraSensor, at: Pose, prefix: str) -> None:
    """Add a sensor to an SDF link. ``at`` is the pose of the sensor's link in it."""
    element = link.add("sensor", name=prefix + sensor.name, type=sensor.type)
    pose = at * sensor.pose
    element.fill(pose=(*clean3(pose.xyz), *clean3(pose.rpy())))
    element.fill(topic=sensor.topic_of(prefix))
    element.fill(gz_frame_id=prefix + sensor.link)
    element.children.extend(sensor.parts)


def _parts(robot: Robot) -> Iterator[ExtraSensor | str]:
    links = {link.name for link in robot.links}
    names = {sensor.name for sensor in robot.sensors}
    for text in robot.urdf_extensions:
        root = parse(text)
        if root.tag != "gazebo":
            continue
        link = _attribute(root, "reference")
        for child in root.children:
            if child.tag != "sensor" or link not in links:
                yield f"<{child.tag}> of `{link}`" if link else _described(child)
                continue
            sensor = _sensor(child, link)
            if isinstance(sensor, ExtraSensor) and sensor.name in names:
                yield f"<sensor> `{sensor.name}` (a second one of this name)"
                continue
            yield sensor
            if isinstance(sensor, ExtraSensor):
                names.add(sensor.name)
                yield from (
                    f"{_described(part)} of the sensor `{sensor.name}`"
                    for part in child.children
                    if part.tag == "plugin"
                )


def _sensor(element: Element, link: str) -> ExtraSensor | str:
    """Return the sensor, or why SDF cannot have it."""
    name, stated = _attribute(element, "name"), _attribute(element, "type")
    kind = RENAMED.get(stated, stated)
    if not name:
        return f"<sensor> of `{link}` (without a name)"
    if kind not in SYSTEMS:
        return f"<sensor> `{name}` (Gazebo has no sensor `{stated}` of a link)"
    pose, topic = Pose(), ""
    parts = []
    for part in element.children:
        if part.tag == "pose":
            stated_pose = _pose(part)
            if stated_pose is None:
                return f"<sensor> `{name}` (its <pose> is not six numbers in m and rad)"
            pose = stated_pose
        elif part.tag == "topic":
            topic = part.text
        elif part.tag not in ("plugin", "gz_frame_id", "ignition_frame_id", "frame_id"):
            part.tag = _PARTS.get(part.tag, part.tag)
            parts.append(part)
    return ExtraSensor(link, name, kind, pose, topic, tuple(parts))


def _pose(element: Element) -> Pose | None:
    """Return a pose in the link, or ``None`` if the text or an attribute says something else."""
    try:
        x, y, z, roll, pitch, yaw = map(float, element.text.split())
    except ValueError:
        return None
    if element.attributes or not math.isfinite(x + y + z + roll + pitch + yaw):
        return None
    return Pose.from_xyz_rpy((x, y, z), (roll, pitch, yaw))


def _attribute(element: Element, name: str) -> str:
    attribute = re.search(rf' {name}="([^"]*)"', element.attributes)
    return html.unescape(attribute[1]) if attribute else ""


def _described(element: Element) -> str:
    file = _attribute(element, "filename")
    return f"<{element.tag}> {file}" if file else f"<{element.tag}>"
