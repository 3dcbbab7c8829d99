"""A layout for Foxglove that shows the MCAP file of a run: robots, frames, odometry and joints.

``templates/foxglove/layout.json`` has the panels, in the form that Foxglove exports and that its
open-source fork Lichtblick reads too; the robots and the plotted fields are added here.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence

from thorvaldc.compiler.recordings import ros_bag
from thorvaldc.diagnostics.files import read_json
from thorvaldc.model import Robot, wheel_joints
from thorvaldc.model.plugins import data_folder

LAYOUT_SUFFIX = ".foxglove.json"
_TWISTS = {
    "odometry": (f"{ros_bag.ODOM}.twist",),
    "truth": (f"{ros_bag.TRUE_ODOM}.twist",),
    "twist": (ros_bag.COMMANDED_TWIST, ros_bag.LIMITED_TWIST),
}
IN_SCENE = tuple(f"sensor_msgs/msg/{kind}" for kind in ("LaserScan", "PointCloud2", "Image"))
"""Types of the measurements that the scene shows."""


def foxglove_layout(
    robots: Sequence[tuple[str, Robot]], groups: Collection[str], measurements: Sequence[str]
) -> str:
    """Returns the layout of a record as JSON text.

    - ``groups``: groups of the recorded values.
    - ``measurements``: topics of the types ``IN_SCENE``.
    """
    template = (data_folder("templates") / "foxglove" / "layout.json").read_text(encoding="utf-8")
    layout = read_json(template)
    scene, speeds, drives, steering = layout["configById"].values()
    scene["topics"] |= {topic: {"visible": True} for topic in measurements}
    if len(robots) == 1:
        scene["followTf"] = f"{robots[0][1].prefix}base_link"
    for name, robot in robots:
        space, label = f"/{robot.prefix}", f"{name} " if len(robots) > 1 else ""
        layer = {"layerId": "foxglove.Urdf", "instanceId": name, "label": name}
        topic = f"{space}{ros_bag.DESCRIPTION}"
        scene["layers"][name] = {**layer, "sourceType": "topic", "topic": topic}
        for twist in (twist for group in _TWISTS if group in groups for twist in _TWISTS[group]):
            topic = twist.removesuffix(".twist")
            if topic != twist:
                scene["topics"][f"{space}{topic}"] = {"visible": True}
            for part, unit in (("linear.x", "vx (m/s)"), ("angular.z", "yaw rate (rad/s)")):
                _plot(speeds, f"{space}{twist}.twist.{part}", f"{label}{topic} {unit}")
        if "joints" in groups:
            joints = wheel_joints(robot)
            for index, joint in enumerate((*joints[0], *joints[1])):
                is_drive = index < len(joints[0])
                field = f"{'velocity' if is_drive else 'position'}[{index}]"
                plot = drives if is_drive else steering
                _plot(plot, f"{space}{ros_bag.JOINTS}.{field}", f"{label}{joint}")
    return json.dumps(layout, indent=1) + "\n"


def _plot(panel: dict[str, list[dict[str, object]]], path: str, label: str) -> None:
    series = {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
    panel["paths"].append(series)
