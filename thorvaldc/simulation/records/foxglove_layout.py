"""A layout for Foxglove that shows the MCAP file of a run: robots, frames, odometry and joints.

The keys are those that Foxglove writes when it exports a layout: a tree of panels that split the
window (``layout``), and the settings of each panel (``configById``), whose key begins with the type
of the panel.  Lichtblick, its open-source fork, reads the same files.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from thorvaldc.compiler.recordings import ros_bag
from thorvaldc.model import Robot, wheel_joints

LAYOUT_SUFFIX = ".foxglove.json"
_ODOMETRY = {"odometry": ros_bag.ODOM, "truth": ros_bag.TRUE_ODOM}
_TWISTS = (ros_bag.COMMANDED_TWIST, ros_bag.LIMITED_TWIST)


def foxglove_layout(robots: Sequence[tuple[str, Robot]], groups: Collection[str]) -> str:
    """Returns the layout of a record as JSON text.  ``groups``: groups of the recorded values."""
    is_fleet = len(robots) > 1
    odometry = [topic for group, topic in _ODOMETRY.items() if group in groups]
    twists = [f"{topic}.twist" for topic in odometry]
    twists += _TWISTS if "twist" in groups else ()
    layers = {"grid": _layer("Grid", "grid", frameId="map", size=100, divisions=100)}
    topics: dict[str, Mapping[str, bool]] = {}
    plots: dict[str, list[tuple[str, str]]] = {
        "Speed of the base": [],
        "Speeds of the drive joints (rad/s)": [],
        "Angles of the steering joints (rad)": [],
    }
    speeds, velocities, angles = plots.values()
    for name, robot in robots:
        space = f"/{robot.prefix}"
        label = f"{name} " if is_fleet else ""
        layers[name] = _layer(
            "Urdf", name, sourceType="topic", topic=f"{space}{ros_bag.DESCRIPTION}"
        )
        topics |= {f"{space}{topic}": {"visible": True} for topic in odometry}
        for twist in twists:
            title = f"{label}{twist.removesuffix('.twist')}"
            speeds.append((f"{space}{twist}.twist.linear.x", f"{title} vx (m/s)"))
            speeds.append((f"{space}{twist}.twist.angular.z", f"{title} yaw rate (rad/s)"))
        if "joints" in groups:
            drives, steering = wheel_joints(robot)
            states = f"{space}{ros_bag.JOINTS}"
            for index, joint in enumerate((*drives, *steering)):
                if index < len(drives):
                    velocities.append((f"{states}.velocity[{index}]", f"{label}{joint}"))
                else:
                    angles.append((f"{states}.position[{index}]", f"{label}{joint}"))
    panels: dict[str, Any] = {
        "3D!robots": {
            "cameraState": {"distance": 15 if is_fleet else 4, "phi": 60, "thetaOffset": 40},
            "followTf": "map" if is_fleet else f"{robots[0][1].prefix}base_link",
            "followMode": "follow-position",
            "scene": {"transforms": {"showLabel": False, "axisScale": 0.5, "lineWidth": 1}},
            "topics": topics,
            "layers": layers,
        }
    }
    panels |= {
        f"Plot!plot{number}": _plot(title, series)
        for number, (title, series) in enumerate(plots.items())
        if series
    }
    first, *others = panels
    layout: Any = first
    if others:
        column = _column(others)
        layout = {"direction": "row", "first": first, "second": column, "splitPercentage": 60}
    content = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(content, indent=1) + "\n"


def _layer(kind: str, name: str, **settings: Any) -> Mapping[str, Any]:
    return {"layerId": f"foxglove.{kind}", "instanceId": name, "label": name, **settings}


def _plot(title: str, series: Iterable[tuple[str, str]]) -> Mapping[str, Any]:
    """Returns the settings of a plot over time.  ``series`` has message path and label of each."""
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
            for path, label in series
        ],
        "xAxisVal": "timestamp",
        "showLegend": True,
        "legendDisplay": "left",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "sidebarDimension": 200,
    }


def _column(panels: Sequence[str]) -> Any:
    """Returns panels of equal height, one below another."""
    first, *others = panels
    if not others:
        return first
    share = round(100 / len(panels))
    second = _column(others)
    return {"direction": "column", "first": first, "second": second, "splitPercentage": share}
