"""Every parameter that is written exists in its node in the distribution, with the same type."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.backends.ros2.packages import DISTROS, parameter_files, variant
from tests.examples import example_robot
from thorvaldc.model import Robot

TABLE: dict[str, dict[str, Any]] = yaml.safe_load(
    Path(__file__).with_name("declared_parameters.yaml").read_text(encoding="utf-8")
)
GROUPS = {
    "behavior_server": ("behavior", "twist"),
    "bt_navigator": ("bt_navigator",),
    "collision_monitor": ("collision_monitor", "twist"),
    "controller_server": ("controller_server", "twist"),
    "ekf_map": ("ekf",),
    "ekf_odom": ("ekf",),
    "global_costmap": ("costmap",),
    "local_costmap": ("costmap",),
    "planner_server": ("planner",),
    "smoother_server": ("smoother",),
    "velocity_smoother": ("velocity_smoother", "twist"),
    "waypoint_follower": ("waypoint",),
}
OURS = {"base_driver"}  # has tests of its own
TYPES = {bool: "bool", int: "integer", float: "double", str: "string"}


def declared(node: str, name: str, distro: str) -> str | None:
    """Return the type of a parameter, or ``None`` if the node does not declare it."""
    for group in GROUPS.get(node, (node,)):
        table = TABLE[group]
        # Plug-ins declare their parameters below their own names, so a name may be a suffix.
        parts = name.split(".")
        for start in range(len(parts)):
            kind = table.get(".".join(parts[start:]))
            if isinstance(kind, dict):
                kind = kind.get(distro)
            if kind is not None:
                return str(kind)
    return None


def type_of(value: Any) -> str:
    if isinstance(value, list):
        return f"{type_of(value[0])}_array"
    return TYPES[type(value)]


def car_with_lidar() -> Robot:
    """A robot that cannot turn on the spot."""
    car, other = example_robot("car"), example_robot("4wd4ws_slim")
    lidar = next(sensor for sensor in other.sensors if sensor.type == "lidar_2d")
    return dataclasses.replace(
        car, sensors=(*car.sensors, dataclasses.replace(lidar, link="base_link"))
    )


def robots(distro: str) -> list[Robot]:
    names = ["4wd4ws_wide", "4wd2ws_tall", "2wd0ws_greenhouse", "9wd9ws"]
    made = [variant(name, distro=distro, odom_tf="ekf", namespace="r1") for name in names]
    car = car_with_lidar()
    return [*made, dataclasses.replace(car, ros=dataclasses.replace(car.ros, distro=distro))]


@pytest.mark.parametrize("distro", DISTROS)
def test_every_parameter_is_declared_with_its_type(distro: str) -> None:
    wrong = []
    for robot in robots(distro):
        for file, nodes in parameter_files(robot).items():
            for node, values in nodes.items():
                short = node.rpartition("/")[2]
                if short in OURS or file == "controllers":
                    continue
                for name, value in values.items():
                    kind = declared(short, name, distro)
                    if kind != type_of(value):
                        wrong.append(f"{node} {name}: {value!r}, declared as {kind}")
    assert wrong == []


def test_the_table_knows_differences_between_distributions() -> None:
    assert declared("controller_server", "FollowPath.prune_distance", "jazzy") == "double"
    assert declared("controller_server", "FollowPath.prune_distance", "lyrical") is None
    assert declared("bt_navigator", "service_introspection_mode", "lyrical") is None
    assert declared("controller_server", "FollowPath.no_such_parameter", "jazzy") is None
