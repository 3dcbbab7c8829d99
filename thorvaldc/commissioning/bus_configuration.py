"""Required configuration of a bus: node ids, identities and object values of all nodes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.model import Bus, Node, Robot
from thorvaldc.model.bus import OBJECT_TYPES
from thorvaldc.model.bus_timing import written_objects
from thorvaldc.model.model_json import typed_value

PARKING = range(112, 127)
"""Node ids that are used only temporarily, while a flash exchanges the ids of nodes."""
STATUSWORDS = (0x6041, 0x6841)
"""Status words (CiA 402) of the first and the second motor of a drive."""


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """Required value of one object in the object dictionary of a node."""

    name: str
    index: int
    subindex: int
    type: str
    value: int

    @property
    def key(self) -> tuple[int, int]:
        """Index and subindex of the object in the object dictionary."""
        return self.index, self.subindex

    @property
    def label(self) -> str:
        """Index (hexadecimal) and subindex of the object dictionary entry as text, for example
        ``1017:0``."""
        return f"{self.index:04x}:{self.subindex}"


PresentValues = Mapping[tuple[int, int], int | None]
"""Values of objects by index and subindex; ``None`` for an object that could not be read."""


def differing_values(
    values: Sequence[ParameterValue], present: PresentValues
) -> list[ParameterValue]:
    """Returns the required values that differ from the present ones."""
    return [value for value in values if present.get(value.key) != value.value]


@dataclass(frozen=True, slots=True)
class NodeConfiguration:
    """Required configuration (node id, identity and object values) of a node.

    - ``name``, ``module``: names of the node and of its module in the robot file;
    - ``protocol``: protocol of the node in the robot file;
    - ``id``: node id; only a rollback can require 255, which means no node id;
    - ``canopen``: ``True`` if the node has a CANopen node id;
    - ``lss``: ``True`` if LSS can set the node id;
    - ``sdo``: ``True`` if the node has an object dictionary;
    - ``drive``: ``True`` if the node can move motors;
    - ``vendor``, ``product``, ``revision``, ``serial``: identity (object 0x1018), ``None`` if the
      robot file contains no number;
    - ``device_type``: object 0x1000, or ``None``;
    - ``heartbeat``: heartbeat period (s), or ``None``;
    - ``seen_by``: identifiers and periods (s) of the periodic frames of the node;
    - ``statuswords``: indices of the objects that report the power state of a motor;
    - ``values``: required values of objects.

    The field names of the class must not be changed, because the journal file uses the names as
    JSON keys.
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
        """Identity of the node, or ``None`` if the robot file does not contain all four numbers of
        the identity."""
        numbers = self.vendor, self.product, self.revision, self.serial
        if self.vendor is None or self.product is None or self.revision is None:
            return None
        return None if self.serial is None else Identity(*(n or 0 for n in numbers))

    def is_like(self, identity: Identity) -> bool:
        """Returns ``True`` if the identity of a device matches the identity of the node in the
        robot file.

        An identity number that the robot file does not contain matches every number.
        """
        required = (self.vendor, self.product, self.revision, self.serial)
        return all(
            number is None or number == actual
            for number, actual in zip(required, identity, strict=True)
        )

    @property
    def states_product(self) -> bool:
        """``True`` if the robot file contains vendor and product, without which the identity of any
        device would match."""
        return self.vendor is not None and self.product is not None

    @property
    def by_hand(self) -> bool:
        """``True`` if the node id can be set only with the tool of the manufacturer."""
        return self.canopen and not self.lss and self.protocol != "foreign"


@dataclass(frozen=True, slots=True)
class BusConfiguration:
    """Required configuration of all nodes on a CAN bus.

    - ``robot``, ``bus``: names of the robot and the bus;
    - ``bitrate``: bitrate in bit/s;
    - ``nodes``: required configurations of the nodes.
    """

    robot: str
    bus: str
    bitrate: int
    nodes: tuple[NodeConfiguration, ...]

    @property
    def hash(self) -> str:
        return digest(asdict(self))

    def node(self, name: str) -> NodeConfiguration:
        """Returns the required configuration of the node ``name``.

        Raises ``KeyError`` if the CAN bus has no node ``name``.
        """
        for node in self.nodes:
            if node.name == name:
                return node
        raise KeyError(name)


def configuration_of(robot: Robot, bus: Bus) -> BusConfiguration:
    """Returns the required configuration of a CAN bus from the robot model."""
    return BusConfiguration(
        robot.name,
        bus.name,
        bus.bitrate,
        tuple(_node_configuration(bus, node) for node in bus.nodes),
    )


def _node_configuration(bus: Bus, node: Node) -> NodeConfiguration:
    sent = [frame for frame in bus.frames if frame.producer == node.name]
    heartbeat = next((f.period for f in sent if f.kind == "heartbeat"), None)
    return NodeConfiguration(
        name=node.name,
        module=node.module,
        protocol=node.protocol,
        id=node.id,
        canopen=node.is_canopen,
        lss=node.lss,
        sdo=any(frame.kind == "sdo" for frame in sent),
        drive=bool(node.channels),
        vendor=node.vendor_id,
        product=node.product_code,
        revision=node.revision_number,
        serial=_number(node.serial),
        device_type=node.device_type,
        heartbeat=heartbeat,
        seen_by=tuple((f.key, f.period) for f in sent if f.period is not None),
        statuswords=tuple(o.index for o in node.objects if o.index in STATUSWORDS),
        values=tuple(
            ParameterValue(o.name, o.index, o.subindex, o.type, o.value)
            for o in written_objects(node)
            if o.value is not None
        ),
    )


def _number(serial: str | None) -> int | None:
    try:
        return None if serial is None else int(serial, 0) & 0xFFFFFFFF
    except ValueError:
        return None


# -- as JSON -------------------------------------------------------------------------------


def digest(value: Any) -> str:
    """Returns the SHA-256 hash of a JSON value; the hash is equal on every computer."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def from_json(value: Mapping[str, Any]) -> BusConfiguration:
    """Converts the JSON form of a bus configuration (``asdict``) into a ``BusConfiguration``.

    Raises ``ValueError`` if the JSON value is not a bus configuration.
    """
    configuration: BusConfiguration = typed_value(BusConfiguration, value)
    for node in configuration.nodes:
        check_node_id(node.id)
        check_values(node.values)
    return configuration


def check_node_id(number: int) -> None:
    """Raises ``ValueError`` if a number is neither a node id nor 255, which means no node id."""
    if not 0 <= number <= UNCONFIGURED:
        raise ValueError(f"{number} is no node id")


def check_values(values: Sequence[ParameterValue]) -> None:
    """Raises ``ValueError`` if a value is not one of an object that a node can have."""
    for entry in values:
        in_range = 0 <= entry.index <= 0xFFFF and 0 <= entry.subindex <= 0xFF
        if not in_range or entry.type not in OBJECT_TYPES:
            raise ValueError(f"{entry.name} is no object of a node")
