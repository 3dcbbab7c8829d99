"""Required configuration of a bus: node ids, identities and object values of all nodes."""

from __future__ import annotations

import hashlib
import json
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.model import Robot
from thorvaldc.model.bus import OBJECT_TYPES, Bus, Node
from thorvaldc.model.model_json import typed_value
from thorvaldc.model.required_objects import written_objects

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

    def has_type_of(self, device_type: int | None, device_id: int | None) -> bool:
        """Returns ``True`` if the device type (object 0x1000) of a device matches the robot file.

        ``device_type``: ``None`` if it is unknown.  It may be unknown for a device at another id
        than its own, and for one without an id, which cannot be asked.
        """
        if self.device_type is None or not self.sdo or device_type == self.device_type:
            return True
        return device_type is None and (device_id != self.id or device_id == UNCONFIGURED)

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
        return digest(to_json(self))

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
        seen_by=tuple((f.cob_id, f.period) for f in sent if f.period is not None),
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
    """Converts the JSON form of a bus configuration into a ``BusConfiguration``.

    Raises ``KeyError``, ``TypeError`` or ``ValueError`` if the JSON value is not a bus
    configuration.
    """
    hints = typing.get_type_hints(NodeConfiguration)
    plain = hints.keys() - {"values"}
    nodes = []
    for entry in value["nodes"]:
        if entry.keys() != hints.keys():
            raise ValueError("the fields of a node are wrong")
        fields = {name: typed_value(hints[name], entry[name], name) for name in plain}
        check_node_id(fields["id"])
        values = values_from_json(entry["values"])
        nodes.append(NodeConfiguration(**fields, values=values))
    robot, bus = typed_value(str, value["robot"]), typed_value(str, value["bus"])
    return BusConfiguration(robot, bus, typed_value(int, value["bitrate"]), tuple(nodes))


def check_node_id(number: int) -> None:
    """Raises ``ValueError`` if a number is neither a node id nor 255, which means no node id."""
    if not 0 <= number <= UNCONFIGURED:
        raise ValueError(f"{number} is no node id")


def values_to_json(values: Sequence[ParameterValue]) -> list[list[Any]]:
    return [[v.name, v.index, v.subindex, v.type, v.value] for v in values]


def values_from_json(value: Sequence[Sequence[Any]]) -> tuple[ParameterValue, ...]:
    """Converts the JSON form of object values.  Raises ``ValueError`` if it is another value."""
    entries = typed_value(tuple[tuple[str, int, int, str, int], ...], value)
    values = tuple(ParameterValue(*entry) for entry in entries)
    for entry in values:
        in_range = 0 <= entry.index <= 0xFFFF and 0 <= entry.subindex <= 0xFF
        if not in_range or entry.type not in OBJECT_TYPES:
            raise ValueError(f"{entry.name} is no object of a node")
    return values


# -- plan ------------------------------------------------------------------------------------------

LSS_SERIAL, LSS_FASTSCAN, ATTACH_ONE, DOWNLOAD = (
    "lss-serial",
    "lss-fastscan",
    "attach-one",
    "parameters",
)
"""Names of the methods by which a step is executed."""


@dataclass(frozen=True, slots=True)
class AddressStep:
    """Step that changes the node id of a device by LSS; the node id 255 means no node id.

    Before an ``AddressStep`` the device must have the node id ``before``, and no device may have
    the node id ``after``.  After an ``AddressStep`` and a reset, exactly one device must respond at
    the node id ``after``, and the identity of the device must match ``identity``.  An
    ``AddressStep`` is undone by an ``AddressStep`` with ``before`` and ``after`` exchanged.
    """

    node: str
    identity: Identity
    before: int
    after: int
    back_end: str = LSS_SERIAL

    @property
    def description(self) -> str:
        if self.before == UNCONFIGURED:
            return f"give {self.node} the id {self.after}"
        if self.after == UNCONFIGURED:
            return f"remove the id {self.before} of {self.node}"
        parked = " (parked)" if self.after in PARKING else ""
        return f"move {self.node} from {self.before} to {self.after}{parked}"


@dataclass(frozen=True, slots=True)
class ConfigureStep:
    """Step that writes the object values of a node.

    A ``ConfigureStep`` writes each object value that differs, and reads the written value back.
    Then a ``ConfigureStep`` stores the object values in the node, resets the node, and reads all
    values again.  Before a ``ConfigureStep`` exactly one node must respond at the node id ``id``,
    and no motor of the node may be enabled.  A ``ConfigureStep`` is undone by a ``ConfigureStep``
    with the previous values in the journal.  ``differing``: number of object values that differ, or
    ``None`` if the number is not known yet.
    """

    node: str
    id: int
    identity: Identity | None
    values: tuple[ParameterValue, ...]
    differing: int | None
    back_end: str = DOWNLOAD

    @property
    def description(self) -> str:
        count = len(self.values) if self.differing is None else self.differing
        unknown = "up to " if self.differing is None else ""
        return f"write {unknown}{count} value{'s' * (count != 1)} of {self.node} (id {self.id})"


@dataclass(frozen=True, slots=True)
class AttachStep:
    """Step in which the operator sets a node id with the tool of the manufacturer.

    For an ``AttachStep`` the operator powers only the module that contains the node.  The program
    writes no values in an ``AttachStep``.  After an ``AttachStep`` exactly one device must respond,
    with the node id ``after`` and the required device type.  Only the operator can undo an
    ``AttachStep``.
    """

    node: str
    after: int
    back_end: str = ATTACH_ONE

    @property
    def description(self) -> str:
        return f"have the operator set the id {self.after} of {self.node} with its maker's tool"


PlanStep = AddressStep | ConfigureStep | AttachStep


@dataclass(frozen=True, slots=True)
class Plan:
    """Commissioning plan: the steps that change the nodes on a CAN bus to the required
    configuration.

    - ``configuration``: required configuration of the bus;
    - ``start``: node ids on the bus before the first step, by name of the node;
    - ``identities``: known identities of the devices, by name of the node;
    - ``steps``: steps in the order of their execution;
    - ``strangers``: devices that do not belong to the robot; a plan with strangers is not executed;
    - ``problems``: reasons that prevent the execution of the plan;
    - ``notes``: messages that do not prevent the execution of the plan.
    """

    configuration: BusConfiguration
    start: tuple[tuple[str, int], ...]
    identities: tuple[tuple[str, Identity], ...]
    steps: tuple[PlanStep, ...]
    strangers: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def hash(self) -> str:
        """SHA-256 hash of the required configuration, the node ids, the identities and the steps of
        the plan."""
        return digest(plan_to_json(self))

    @property
    def ids(self) -> dict[str, set[int]]:
        """All node ids that each node has during the execution of the plan, by name of the node."""
        ids: dict[str, set[int]] = {name: {node} for name, node in self.start}
        for step in self.steps:
            if isinstance(step, AddressStep):
                ids.setdefault(step.node, set()).update((step.before, step.after))
            elif isinstance(step, AttachStep) and step.node in ids:
                ids[step.node].add(step.after)
        return ids


# -- as JSON ------------------------------------------------------------------------------------


def step_to_json(step: PlanStep) -> dict[str, Any]:
    if isinstance(step, AddressStep):
        return {
            "kind": "address",
            "node": step.node,
            "identity": list(step.identity),
            "before": step.before,
            "after": step.after,
            "back_end": step.back_end,
        }
    if isinstance(step, ConfigureStep):
        return {
            "kind": "configure",
            "node": step.node,
            "id": step.id,
            "identity": None if step.identity is None else list(step.identity),
            "values": values_to_json(step.values),
            "differing": step.differing,
            "back_end": step.back_end,
        }
    return {"kind": "attach", "node": step.node, "after": step.after, "back_end": step.back_end}


def step_from_json(value: Mapping[str, Any]) -> PlanStep:
    node = typed_value(str, value["node"])
    if value["kind"] == "address":
        return AddressStep(
            node,
            _identity_from_json(value["identity"]),
            _node_id_from_json(value["before"]),
            _node_id_from_json(value["after"]),
            typed_value(str, value["back_end"]),
        )
    if value["kind"] == "configure":
        identity = value["identity"]
        return ConfigureStep(
            node,
            _node_id_from_json(value["id"]),
            None if identity is None else _identity_from_json(identity),
            values_from_json(value["values"]),
            typed_value(int | None, value["differing"]),
        )
    return AttachStep(node, _node_id_from_json(value["after"]))


def _node_id_from_json(value: Any) -> int:
    number: int = typed_value(int, value)
    check_node_id(number)
    return number


def _identity_from_json(value: Any) -> Identity:
    identity = Identity(*typed_value(tuple[int, int, int, int], value))
    if not all(0 <= number < 1 << 32 for number in identity):
        raise ValueError(f"{identity} is no identity")
    return identity


def plan_to_json(plan: Plan) -> dict[str, Any]:
    return {
        "target": to_json(plan.configuration),
        "start": [list(pair) for pair in plan.start],
        "identities": [[name, list(identity)] for name, identity in plan.identities],
        "steps": [step_to_json(step) for step in plan.steps],
    }


def plan_from_json(value: Mapping[str, Any]) -> Plan:
    """Converts the JSON form of a commissioning plan into a ``Plan``.

    Raises ``KeyError``, ``TypeError`` or ``ValueError`` if the JSON value is not a commissioning
    plan.
    """
    return Plan(
        from_json(value["target"]),
        tuple((typed_value(str, n), _node_id_from_json(i)) for n, i in value["start"]),
        tuple((typed_value(str, n), _identity_from_json(i)) for n, i in value["identities"]),
        tuple(step_from_json(step) for step in value["steps"]),
    )
