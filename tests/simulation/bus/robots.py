"""Robots with buses, compiled once for all tests of the simulated bus."""

from __future__ import annotations

import functools
import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.slow import mostly_exhaustive
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Node, ObjectValue, Robot

CIA402 = """
thorvaldc: 1
name: with_cia402
foreign_devices:
  sprayer:
    id: 40
    canopen: [heartbeat]
    frames:
      command: {cob_id: 0x240, direction: command, rate: 10 Hz}
      state: {cob_id: 0x1C0, direction: report, rate: 10 Hz, length: 4}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, params: &p
    {controller: controller/cia402_propulsion_steering}, can: {id: 1, serial: "0x101"}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, params: *p,
    can: {id: 2, serial: "0x102"}}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, params: *p,
    can: {id: 3, serial: "0x103"}}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, params: *p,
    can: {id: 4, serial: "0x104"}}
  board: {type: io/board, params: {relay_1_at_start: true}, can: 32}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}, can: 1}
"""


@functools.cache
def compiled(text: str) -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.yaml"
        path.write_text(text, encoding="utf-8")
        compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), list(compilation.report)
    return compilation.model


def cia402_robot() -> Robot:
    """Returns a robot with four CiA 402 drives, an IO board, a battery and a foreign device."""
    return compiled(CIA402)


@functools.cache
def drives() -> Robot:
    """Returns the robot with four CiA 402 drives, which home where they stand."""
    return at_home(cia402_robot())


def at_home(robot: Robot) -> Robot:
    """Returns a robot whose CiA 402 drives home where they stand: a search would take 12 s."""
    homing_objects = {"steering_homing_method": 35, "steering_home_offset": 0}

    def changed(node: Node) -> Node:
        objects = [replace(o, value=homing_objects.get(o.name, o.value)) for o in node.objects]
        return replace(node, objects=tuple(objects))

    buses = [replace(bus, nodes=tuple(map(changed, bus.nodes))) for bus in robot.buses]
    return replace(robot, buses=tuple(buses))


MODULES = Path(__file__).resolve().parents[3] / "modules"
STEERED = "type: assembly/steered_drive, params: {controller: controller"
UNEVEN = f"""
thorvaldc: 1
name: uneven
modules:
  frame: {{type: frame/tube_rectangular, params: {{length: 1.1 m, width: 0.9 m, height: 650 mm}}}}
  fl: {{{STEERED}/steering_first}}, mount: frame.front_left, can: {{id: 7, serial: "0x107"}}}}
  fr: {{{STEERED}/steering_listed_first, gear_ratio: 30}}, mount: frame.front_right,
    can: {{id: 2, serial: "0x102"}}}}
  rl: {{{STEERED}/steering_first, gear_ratio: 50}}, mount: frame.rear_left,
    can: {{id: 5, serial: "0x105"}}}}
  rr: {{type: assembly/endless_drive, mount: frame.rear_right, can: 4}}
"""


@functools.cache
def uneven_robot() -> Robot:
    """Returns a robot whose controllers differ in the order of their channels and in their gears.

    Two controllers have the steering as their first channel and their first motor; another one
    lists the steering first, but has it as its second motor.  The wheel ``rr`` has a controller of
    another kind, and its steering joint has no limits.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = (MODULES / "controller/cia402_propulsion_steering/module.yaml").read_text("utf-8")
        first, second = "  propulsion: {role: propulsion}\n", "  steering: {role: steering}\n"
        assert first + second in text
        text = text.replace(first + second, second + first)
        (folder / "library/controller/steering_listed_first").mkdir(parents=True)
        path = folder / "library/controller/steering_listed_first/module.yaml"
        path.write_text(text, "utf-8")
        # The objects of the first axis begin at 0x6000, those of the second at 0x6800.
        text = re.sub(r"0x6[0-9A-F]{3}\b", lambda m: f"{int(m[0], 16) ^ 0x800:#06x}", text)
        (folder / "library/controller/steering_first").mkdir(parents=True)
        (folder / "library/controller/steering_first/module.yaml").write_text(text, "utf-8")
        shutil.copytree(MODULES / "steering/standard", folder / "library/steering/endless")
        path = folder / "library/steering/endless/module.yaml"
        text = path.read_text("utf-8").replace("type: revolute", "type: continuous")
        limits = "    lower: ${-limit}\n    upper: ${limit}\n"
        assert limits in text
        path.write_text(text.replace(limits, ""), "utf-8")
        (folder / "library/assembly/endless_drive").mkdir(parents=True)
        text = (MODULES / "assembly/steered_drive/module.yaml").read_text("utf-8")
        path = folder / "library/assembly/endless_drive/module.yaml"
        path.write_text(text.replace("steering/standard", "steering/endless"), "utf-8")
        path = folder / "robot.yaml"
        path.write_text(UNEVEN, "utf-8")
        compilation = compile_file(path, library=[folder / "library"])
    assert isinstance(compilation.model, Robot), list(compilation.report)
    return compilation.model


TWO_DRIVES = """
thorvaldc: 1
name: two_drives
modules:
  frame: {{type: frame/tube_rectangular,
    params: {{length: 1.2 m, width: 800 mm, cross_members: [-100 mm]}}}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left{controller}, can: 1}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right{controller}, can: 2}}
  rl: {{type: caster/swivel, mount: frame.rear_left}}
  rr: {{type: caster/swivel, mount: frame.rear_right}}
  battery: {{type: battery/enclosure, mount: {{parent: frame, xyz: [0, 0, 0.07]}}, can: 1}}
"""


def cia402() -> Robot:
    """A robot with CiA 402 drives that home ten times faster than usual, to save time."""
    controller = "controller/cia402_propulsion_steering"
    robot = compiled(TWO_DRIVES.format(controller=f", params: {{controller: {controller}}}"))
    return quick_to_home(robot)


def quick_to_home(robot: Robot) -> Robot:
    """Returns a robot whose CiA 402 drives home ten times faster."""
    nodes = tuple(
        replace(node, objects=tuple(_quicker(entry) for entry in node.objects))
        for node in robot.buses[0].nodes
    )
    return replace(robot, buses=(replace(robot.buses[0], nodes=nodes),))


def _quicker(entry: ObjectValue) -> ObjectValue:
    homes = entry.name.startswith("steering_homing_") and entry.index in (0x6899, 0x689A)
    return replace(entry, value=10 * (entry.value or 0)) if homes else entry


def roboteq() -> Robot:
    return compiled(TWO_DRIVES.format(controller=""))


ROBOTS: dict[str, Callable[[], Robot]] = {"CiA 402": cia402, "Thorvald script": roboteq}


def each_drive(argument: str) -> Any:
    """Runs a test with both robots of ``ROBOTS``; CiA 402, which takes longer, is `exhaustive`."""
    names = list(reversed(ROBOTS))
    return pytest.mark.parametrize(argument, mostly_exhaustive(map(ROBOTS.get, names)), ids=names)
