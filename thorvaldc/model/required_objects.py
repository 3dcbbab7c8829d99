"""The objects of a CANopen node that must have the values of the robot file: one table for all.

- `can flash` writes the objects that can be written, and `can verify` compares them all;
- the base driver compares them all at the start-up, and reads them again and again;
- ``OBJECT_GROUPS`` tells for each object why its value matters; docs/faults.md has it as a table.

While a robot runs, another interface of a drive (USB, a service tool) can change each of these
objects, and nothing else on the bus shows it.  The base driver reads one object in each control
cycle T on each bus.  With N objects of all nodes of the bus, a change is found within N T, as long
as each node answers within a cycle:

    cycle    |    1    |    2    |    3    |         |    N    |   N + 1
    driver   RPDO SYNC SDO upload of object 1        ...  N         1
    node               value of object 1
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from thorvaldc.model.bus import Bus, Node, ObjectValue
from thorvaldc.model.bus_timing import MASTER
from thorvaldc.model.robot import Robot
from thorvaldc.model.stopping import motor_nodes


class ObjectGroup(NamedTuple):
    """Objects with the same purpose, from the index ``first`` to the index ``last``.

    - ``name``: name of the objects in CiA 301 or CiA 402;
    - ``effect``: what the node does if another value is in the object.
    """

    first: int
    last: int
    name: str
    effect: str


OBJECT_GROUPS = (
    ObjectGroup(0x1000, 0x1000, "device type", "it is another device"),
    ObjectGroup(0x1005, 0x1007, "SYNC", "it applies no command and reports nothing"),
    ObjectGroup(0x1014, 0x1015, "EMCY", "it does not report its errors"),
    ObjectGroup(0x1016, 0x1016, "heartbeat consumer", "it runs on when the driver has failed"),
    ObjectGroup(0x1017, 0x1017, "heartbeat producer", "the driver misses its failure"),
    ObjectGroup(0x1018, 0x1018, "identity", "it is another device"),
    ObjectGroup(0x1029, 0x1029, "error behaviour", "it runs on after a communication error"),
    ObjectGroup(0x1400, 0x15FF, "RPDO communication", "it ignores commands, or those of others"),
    ObjectGroup(0x1600, 0x17FF, "RPDO mapping", "it takes a command for another one"),
    ObjectGroup(0x1800, 0x19FF, "TPDO communication", "it reports nothing, or as another node"),
    ObjectGroup(0x1A00, 0x1BFF, "TPDO mapping", "it reports other values"),
    ObjectGroup(0x2000, 0x5FFF, "manufacturer's objects", "as its manual says"),
    ObjectGroup(0x6000, 0x9FFF, "drive profile", "it moves or stops in another way"),
)
"""All objects whose values a robot file can require, in the order of their indices."""


def object_group(index: int) -> ObjectGroup | None:
    """Returns the group of an object, or ``None`` if its value does not matter."""
    return next((group for group in OBJECT_GROUPS if group.first <= index <= group.last), None)


def written_objects(node: Node) -> Iterator[ObjectValue]:
    """Yields the objects that `can flash` writes."""
    return (entry for entry in node.objects if entry.access == "rw" and entry.value is not None)


def required_objects(bus: Bus, node: Node) -> Iterator[ObjectValue]:
    """Yields the objects that the base driver compares with the robot file.

    They are the objects with a value, but not those that an RPDO contains: the base driver writes
    them itself, in each control cycle, and a drive keeps the last value of an earlier run, such as
    the mode of operation of a homing.
    """
    commanded = {
        (index, subindex)
        for frame in bus.frames
        if frame.producer == MASTER and node.name in frame.consumers
        for index, subindex, _ in frame.mapping
    }
    return (
        entry
        for entry in node.objects
        if entry.value is not None and (entry.index, entry.subindex) not in commanded
    )


def reading_time(bus: Bus, cycle: float) -> float:
    """Returns the time in s in which the base driver reads all required objects of a bus once.

    ``cycle``: control cycle of the robot in s.
    """
    motors = [n for n in bus.nodes if any(c.actuator is not None for c in n.channels)]
    return cycle * sum(1 for node in motors for _ in required_objects(bus, node))


def start_reading_time(robot: Robot) -> float:
    """Returns the time in s in which the base driver reads all required objects at its start.

    It reads one object of each motor controller per control cycle, while it reads one of each bus
    during the drive (``reading_time``).
    """
    counts = [len(list(required_objects(bus, node))) for bus, node in motor_nodes(robot)]
    return max(counts, default=0) / robot.driver.rate
