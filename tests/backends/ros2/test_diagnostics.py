"""The configuration of diagnostic_aggregator, by the rules of its sources.

Sources: src/generic_analyzer.cpp and src/analyzer_group.cpp of diagnostic_aggregator in
ros/diagnostics, branches ros2 (431926f) and ros2-jazzy (31372a2).  No registry of Python has the
program itself.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
import yaml

from tests.backends.ros2.packages import named, variant
from tests.examples import FOLDER, SAMPLED_ROBOTS, example_robot
from thorvaldc.model import Robot
from thorvaldc.model.ros2_driver import Ros2Driver
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

ROS = FOLDER.parent / "thorvaldc" / "ros"
ANALYZER = "diagnostic_aggregator/GenericAnalyzer"
PACKAGES = {path.parent.name for path in FOLDER.glob("*/pyproject.toml")}
"""Examples whose drivers of devices are packages of their own, which are not installed."""


def analyzers_of(robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the parameters of each analyzer, as AnalyzerGroup::init makes them.

    A group of parameters is an analyzer if it has a type and a path.  Its path is its name.
    """
    nodes = yaml.safe_load(named(robot, "config/diagnostics.yaml"))
    (parameters,) = nodes.values()
    values = dict(parameters["ros__parameters"])
    assert values.pop("path") == robot.name
    analyzers = {group["path"]: group for group in values.values()}
    assert len(analyzers) == len(values)
    for analyzer in analyzers.values():
        assert analyzer["type"] == ANALYZER
        assert analyzer.keys() & {"regex", "expected", "startswith", "contains"}
    return analyzers


def matches(name: str, analyzer: Mapping[str, Any]) -> bool:
    """Whether GenericAnalyzer::match takes a status."""
    return (
        any(re.fullmatch(pattern, name, re.ASCII) for pattern in analyzer.get("regex", ()))
        or name in analyzer.get("expected", ())
        or any(name.startswith(start) for start in analyzer.get("startswith", ()))
        or any(part in name for part in analyzer.get("contains", ()))
    )


def groups_of(name: str, analyzers: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the groups that contain a status; the one without a group is `Other`."""
    return [group for group, analyzer in analyzers.items() if matches(name, analyzer)]


def names_in(file: str, pattern: str) -> set[str]:
    return set(re.findall(pattern, (ROS / file).read_text(encoding="utf-8")))


def published(robot: Robot) -> Iterator[str]:
    """Yield the name of each status of a base driver, whatever base it has."""
    start = f"{robot.prefix}base_driver: "
    fixed = names_in("messages.py", r'f"\{name\}: ([a-z ]+)"')
    assert fixed == {"driver", "commands", "timing"}
    topics = names_in("topic_base.py", r'ComponentStatus\("([a-z ]+)"')
    assert topics == {"joint topics"}
    yield from (start + name for name in sorted(fixed | topics))
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    interfaces = {bus.name: simulated.interface(bus.name, fifo=True) for bus in robot.buses}
    base = CanBase(robot, interfaces, threaded=False)
    yield from (start + status.name for status in base.component_statuses(0.0))


@pytest.mark.parametrize("namespace", ["", "farm/r1"])
@pytest.mark.parametrize("name", sorted({*SAMPLED_ROBOTS, "car"} - PACKAGES))
def test_each_status_of_the_base_driver_is_in_one_group(name: str, namespace: str) -> None:
    robot = variant(name, namespace=namespace)
    names = list(published(robot))
    assert len(set(names)) == len(names) > 4
    analyzers = analyzers_of(robot)
    for status in names:
        assert len(groups_of(status, analyzers)) == 1, status
    expected = set(analyzers["base_driver"]["expected"])
    assert expected <= set(names)


def test_a_name_that_begins_with_another_is_in_its_own_group() -> None:
    """Of a motor controller of a lift, beside a battery."""
    robot = example_robot("4wd4ws_wide")
    motors = robot.actuators
    node = next(motor.node for motor in motors if motor.node is not None)
    battery = robot.batteries[0].name
    lift = f"{battery}_lift_controller"
    renamed = [dataclasses.replace(m, node=lift) if m.node == node else m for m in motors]
    robot = dataclasses.replace(robot, actuators=tuple(renamed))
    analyzers = analyzers_of(robot)
    assert groups_of(f"base_driver: {lift}", analyzers) == ["motor_controllers"]
    assert groups_of(f"base_driver: {battery}", analyzers) == ["batteries"]


def test_statuses_of_drivers_of_sensors_are_in_their_group() -> None:
    """diagnostic_updater begins them with the name of the node, without its name space."""
    robot = variant("4wd4ws_wide", namespace="r1")
    assert "sensors" not in analyzers_of(robot)
    driver = Ros2Driver("urg_node", "urg_node_driver", "laser_frame_id", (("scan", "scan"),))
    sensors = [dataclasses.replace(s, ros2_driver=driver) for s in robot.sensors]
    robot = dataclasses.replace(robot, sensors=tuple(sensors))
    analyzers = analyzers_of(robot)
    for sensor in sensors:
        assert groups_of(f"{sensor.name}_node: Hardware Status", analyzers) == ["sensors"]
    for status in published(robot):
        assert len(groups_of(status, analyzers)) == 1, status


def test_expressions_are_names_as_they_are() -> None:
    """A name with a character that has a meaning in an expression would match other names."""
    for name in SAMPLED_ROBOTS:
        for analyzer in analyzers_of(example_robot(name)).values():
            for pattern in analyzer.get("regex", ()):
                assert re.fullmatch(r"[A-Za-z0-9_/: ]+", pattern)
