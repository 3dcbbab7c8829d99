"""Five small robots for random missions, with both kinds of drives."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

from tests.simulation.bus.robots import cia402 as steered_cia402
from tests.simulation.bus.robots import compiled
from thorvaldc.model import Node, ObjectValue, Robot
from thorvaldc.model.settings import AUTOMATIC

_STEERED_SCRIPT = """
thorvaldc: 1
name: steered_script
buses: {front: {}, rear: {}}
foreign_devices:
  sprayer:
    bus: front
    id: 40
    canopen: [heartbeat]
    frames:
      command: {cob_id: 0x240, direction: command, rate: 10 Hz}
      state: {cob_id: 0x1C0, direction: report, rate: 10 Hz, length: 4}
modules:
  frame: {type: frame/tube_rectangular,
    params: {length: 1.2 m, width: 800 mm, cross_members: [-100 mm]}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: {bus: front, id: 1}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: {bus: rear, id: 2}}
  rl: {type: caster/swivel, mount: frame.rear_left}
  rr: {type: caster/swivel, mount: frame.rear_right}
  board: {type: io/board, can: {bus: front, id: 32}}
"""
_DIFFERENTIAL = """
thorvaldc: 1
name: differential_%(drives)s
base_calculator: differential
modules:
  frame: {type: frame/sheet_metal}
  left: {type: assembly/fixed_drive, mount: frame.drive_left, params: &drive
    {height: 320 mm, clamp: false}}
  right: {type: assembly/fixed_drive, mount: frame.drive_right, params: *drive}
%(controllers)s
  caster_left: {type: caster/swivel, mount: frame.rear_left, params: &caster
    {height: 200 mm, radius: 60 mm, width: 40 mm, trail: 40 mm}}
  caster_right: {type: caster/swivel, mount: frame.rear_right, params: *caster}
  battery:
    type: battery/enclosure
    mount: {parent: frame, xyz: [-0.16, 0, 0.03]}
    params: {length: 480 mm, width: 240 mm, height: 170 mm, clamps: false}
    can: 1
"""
_SCRIPT_CONTROLLER = """
  controller:
    type: controller/propulsion_propulsion
    channels: {left: left.propulsion, right: right.propulsion}
    can: 1
"""
_CIA402_CONTROLLERS = """
  left_controller: {type: controller/cia402_propulsion, can: 1,
    channels: {propulsion: left.propulsion}}
  right_controller: {type: controller/cia402_propulsion, can: 2,
    channels: {propulsion: right.propulsion}}
"""


def steered_script() -> Robot:
    """Returns a robot with two buses, an IO board and a device of another maker."""
    return compiled(_STEERED_SCRIPT)


def differential_script() -> Robot:
    """Returns a robot with one controller for both wheels, and a battery."""
    return compiled(_DIFFERENTIAL % {"drives": "script", "controllers": _SCRIPT_CONTROLLER})


def differential_automatic() -> Robot:
    """Returns ``differential_cia402``, which arms itself."""
    robot = differential_cia402()
    return replace(robot, driver=replace(robot.driver, arming=AUTOMATIC))


def differential_cia402() -> Robot:
    """Returns a robot with a controller for each wheel, and a battery."""
    return compiled(_DIFFERENTIAL % {"drives": "cia402", "controllers": _CIA402_CONTROLLERS})


ROBOTS: dict[str, Callable[[], Robot]] = {
    "steered_cia402": steered_cia402,
    "steered_script": steered_script,
    "differential_cia402": differential_cia402,
    "differential_script": differential_script,
    "differential_automatic": differential_automatic,
}
"""Robots by name.  The steered CiA 402 robot has a battery, and homes faster than usual."""


LOUD_SOURCE = "loud"
"""Twist source with the priority of the safety stop; the compiler refuses such a source."""


@functools.cache
def chaos_robot(name: str) -> Robot:
    """Returns a robot, with an additional twist source that must not reach a stop lock either.

    The drives have serial numbers, by which new drives can be told apart.
    """
    robot = ROBOTS[name]()
    loud = replace(robot.twist_sources[0], name=LOUD_SOURCE, priority=255)
    buses = tuple(replace(bus, nodes=tuple(map(_with_serial, bus.nodes))) for bus in robot.buses)
    return replace(robot, twist_sources=(*robot.twist_sources, loud), buses=buses)


def _with_serial(node: Node) -> Node:
    return replace(node, serial=f"{0x100 + node.id:#x}") if node.lss else node


def wrong_file(robot: Robot) -> Robot:
    """Returns a robot file that does not fit: every encoder has twice as many pulses."""
    actuators = tuple(
        replace(actuator, encoder_ppr=2 * actuator.encoder_ppr) for actuator in robot.actuators
    )
    buses = tuple(
        replace(
            bus, nodes=tuple(replace(n, objects=tuple(map(_other, n.objects))) for n in bus.nodes)
        )
        for bus in robot.buses
    )
    return replace(robot, actuators=actuators, buses=buses)


def _other(entry: ObjectValue) -> ObjectValue:
    """Doubles the encoder pulses in an object of a CiA 402 drive."""
    is_encoder = entry.index & 0x7FF == 0x08F and entry.subindex == 1 and entry.value is not None
    return replace(entry, value=2 * (entry.value or 0)) if is_encoder else entry
