"""Which of a robot's buses the devices at a CAN interface belong to.

A robot with two equal drives on each of two buses drives wrongly if the two CAN adapters are
exchanged.  Node ids and serial numbers tell the buses apart.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from thorvaldc.model.bus import MASTER, Bus
from thorvaldc.model.bus_timing import required_objects

SERIAL_NUMBER = (0x1018, 4)
"""Index and subindex of the serial number in the object dictionary."""


class Heard(NamedTuple):
    """What the devices at a CAN interface have told about themselves.

    - ``keys``: keys of received frames, see ``EXTENDED`` in the module ``bus``.
    - ``serials``: serial numbers that were read.
    """

    keys: Collection[int]
    serials: Collection[int]


def wrong_buses(buses: Sequence[Bus], heard: Mapping[str, Heard]) -> str:
    """Names the buses at whose interfaces all devices of another bus are, or returns "".

    - ``heard``: devices by the name of the bus at whose interface they are.  Devices that no bus
      has do not count.
    """
    owners = {name: _owner(buses, name, devices) for name, devices in heard.items()}
    texts = []
    for name, owner in owners.items():
        if owner and owners.get(owner) != name:
            texts.append(f"the devices of the bus `{owner}` are on the bus `{name}`")
        elif owner and name < owner:
            texts.append(f"the buses `{name}` and `{owner}` are exchanged")
    return "; ".join(texts)


def _owner(buses: Sequence[Bus], name: str, devices: Heard) -> str:
    """Returns the only other bus to which all devices on the bus ``name`` belong, or ""."""
    ids = {b.name: {f.key for f in b.frames if f.producer != MASTER} for b in buses}
    serials = {b.name: {node.serial_number for node in b.nodes} for b in buses}
    possible = [
        owners
        for known, numbers in ((ids, devices.keys), (serials, devices.serials))
        for number in numbers
        if (owners := {bus for bus in known if number in known[bus]})
    ]
    common = set.intersection(*possible) if possible else {name}
    return common.pop() if len(common) == 1 and name not in common else ""


def are_alike(first: Bus, second: Bus) -> bool:
    """Whether two buses with motor controllers cannot be told apart if they are exchanged.

    The base driver compares all required values of the controllers with the devices, the serial
    number too.
    """
    controllers = _controllers(first)
    return bool(controllers) and controllers == _controllers(second)


def _controllers(bus: Bus) -> set[tuple[object, ...]]:
    return {
        (
            *(node.id_space, node.id, node.protocol, node.serial),
            *((entry.index, entry.subindex, entry.value) for entry in required_objects(bus, node)),
        )
        for node in bus.nodes
        if any(channel.actuator is not None for channel in node.channels)
    }
