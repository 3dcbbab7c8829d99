"""What a bus is to be: its nodes with their identities, addresses and values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.model.bus import Bus, Node
from thorvaldc.model.robot import Robot

CANOPEN = "canopen"
PARKING = range(112, 127)
"""Ids that belong to nobody but while addresses are changed."""
STATUSWORDS = (0x6041, 0x6841)


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """An entry of a node's object dictionary that is to have a value."""

    name: str
    index: int
    subindex: int
    type: str
    value: int

    @property
    def place(self) -> tuple[int, int]:
        return self.index, self.subindex

    @property
    def shown(self) -> str:
        return f"{self.index:04x}:{self.subindex}"


@dataclass(frozen=True, slots=True)
class NodeConfiguration:
    """A node as it is to be.

    ``id`` 255: without one, as only a way back can want it.  ``sdo``: its object dictionary can be
    read.  ``seen_by``: identifiers that it sends by itself, with their periods (s).
    ``statuswords``: objects that say whether a drive is enabled.
    """

    name: str
    module: str
    protocol: str
    id: int
    canopen: bool
    lss: bool
    sdo: bool
    drive: bool
    vendor: int | None
    product: int | None
    revision: int | None
    serial: int | None
    device_type: int | None
    heartbeat: float | None
    seen_by: tuple[tuple[int, float], ...]
    statuswords: tuple[int, ...]
    values: tuple[ParameterValue, ...]

    @property
    def identity(self) -> Identity | None:
        """Where the robot says it whole."""
        numbers = self.vendor, self.product, self.revision, self.serial
        if self.vendor is None or self.product is None or self.revision is None:
            return None
        return None if self.serial is None else Identity(*(n or 0 for n in numbers))

    def is_like(self, identity: Identity) -> bool:
        """Whether a device of that identity may be it; what the robot does not say fits."""
        mine = (self.vendor, self.product, self.revision, self.serial)
        return all(a is None or a == b for a, b in zip(mine, identity, strict=True))

    @property
    def by_hand(self) -> bool:
        """Its address is set with its maker's tool."""
        return self.canopen and not self.lss and self.protocol != "foreign"


@dataclass(frozen=True, slots=True)
class BusConfiguration:
    """All nodes of a bus.  ``robot`` and ``bus`` are names; ``bitrate`` in bit/s."""

    robot: str
    bus: str
    bitrate: int
    nodes: tuple[NodeConfiguration, ...]

    @property
    def hash(self) -> str:
        return digest(to_json(self))

    def node(self, name: str) -> NodeConfiguration:
        """Raises ``KeyError``."""
        for node in self.nodes:
            if node.name == name:
                return node
        raise KeyError(name)


def configuration_of(robot: Robot, bus: Bus) -> BusConfiguration:
    """What the robot's file wants of one of its buses."""
    return BusConfiguration(
        robot.name, bus.name, bus.bitrate, tuple(_wanted(bus, node) for node in bus.nodes)
    )


def _wanted(bus: Bus, node: Node) -> NodeConfiguration:
    sent = [frame for frame in bus.frames if frame.producer == node.name]
    heartbeat = next((f.period for f in sent if f.kind == "heartbeat"), None)
    return NodeConfiguration(
        name=node.name,
        module=node.module,
        protocol=node.protocol,
        id=node.id,
        canopen=node.id_space == CANOPEN,
        lss=node.lss,
        sdo=any(frame.kind == "sdo" for frame in sent),
        drive=bool(node.channels),
        vendor=node.vendor_id,
        product=node.product_code,
        revision=node.revision_number,
        serial=_number(node.serial),
        device_type=node.device_type,
        heartbeat=heartbeat,
        seen_by=tuple((f.cob_id, f.period) for f in sent if f.period is not None),
        statuswords=tuple(o.index for o in node.objects if o.index in STATUSWORDS),
        values=tuple(
            ParameterValue(o.name, o.index, o.subindex, o.type, o.value)
            for o in node.objects
            if o.access == "rw" and o.value is not None
        ),
    )


def _number(serial: str | None) -> int | None:
    try:
        return None if serial is None else int(serial, 0) & 0xFFFFFFFF
    except ValueError:
        return None


# -- as JSON -------------------------------------------------------------------------------


def digest(value: Any) -> str:
    """A hash of what can be said in JSON, the same on every machine."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def to_json(target: BusConfiguration) -> dict[str, Any]:
    nodes = []
    for node in target.nodes:
        entry: dict[str, Any] = {
            name: getattr(node, name) for name in NodeConfiguration.__slots__ if name != "values"
        }
        entry["seen_by"] = [list(pair) for pair in node.seen_by]
        entry["statuswords"] = list(node.statuswords)
        entry["values"] = values_to_json(node.values)
        nodes.append(entry)
    return {
        "robot": target.robot,
        "bus": target.bus,
        "bitrate": target.bitrate,
        "nodes": nodes,
    }


def from_json(value: Mapping[str, Any]) -> BusConfiguration:
    """Raises ``KeyError``, ``TypeError`` or ``ValueError`` where it is none."""
    nodes = []
    for entry in value["nodes"]:
        given = dict(entry)
        given["seen_by"] = tuple((int(a), float(b)) for a, b in entry["seen_by"])
        given["statuswords"] = tuple(entry["statuswords"])
        given["values"] = values_from_json(entry["values"])
        nodes.append(NodeConfiguration(**given))
    return BusConfiguration(value["robot"], value["bus"], value["bitrate"], tuple(nodes))


def values_to_json(values: Sequence[ParameterValue]) -> list[list[Any]]:
    return [[v.name, v.index, v.subindex, v.type, v.value] for v in values]


def values_from_json(value: Sequence[Sequence[Any]]) -> tuple[ParameterValue, ...]:
    return tuple(ParameterValue(*entry) for entry in value)


__all__ = [
    "PARKING",
    "UNCONFIGURED",
    "BusConfiguration",
    "Identity",
    "NodeConfiguration",
    "ParameterValue",
    "configuration_of",
    "digest",
    "from_json",
    "to_json",
    "values_from_json",
    "values_to_json",
]
