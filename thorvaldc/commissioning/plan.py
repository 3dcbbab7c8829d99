"""Commissioning plan with the steps of a flash, and the conversion of the plan to and from JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import (
    PARKING,
    BusConfiguration,
    ParameterValue,
    check_node_id,
    digest,
    from_json,
    to_json,
    values_from_json,
    values_to_json,
)
from thorvaldc.model.model_json import typed_value

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
