"""The plan of a flash: its steps, and their form in JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import (
    PARKING,
    BusConfiguration,
    ParameterValue,
    digest,
    from_json,
    to_json,
    values_from_json,
    values_to_json,
)

LSS_SERIAL, LSS_FASTSCAN, ATTACH_ONE, DOWNLOAD = (
    "lss-serial",
    "lss-fastscan",
    "attach-one",
    "parameters",
)
"""Methods of the steps."""


@dataclass(frozen=True, slots=True)
class AddressStep:
    """Gives a device, addressed by its identity, another id; 255 removes the id.

    Precondition: the device has the id ``before``, and no device has ``after``.  Check: after a
    reset exactly one device answers at ``after``, with this identity.  Inverse: the step
    with both ids exchanged.
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
    """Writes the values that differ, reads each back, stores them, resets, and reads all again.

    Precondition: the node alone answers at ``id``, and is not enabled.  Inverse: the step with
    the previous values, which the journal contains.  ``differing`` ``None``: not known yet.
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
    """The operator powers one module alone and sets its id with the maker's tool.

    The flash writes nothing.  Check: exactly one device answers, with this id and the right type.
    The operator also does the inverse.
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
    """``start``: the present ids by node.  ``identities``: by node, where they are known.

    ``strangers`` (devices that are not the robot's) and ``problems`` prevent the execution;
    ``notes`` do not.
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
        """Hash of the required configuration, the present ids and identities, and the steps."""
        return digest(plan_to_json(self))

    @property
    def ids(self) -> dict[str, set[int]]:
        """All ids that a node has at any time during the plan."""
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
    if value["kind"] == "address":
        return AddressStep(
            value["node"],
            Identity(*value["identity"]),
            value["before"],
            value["after"],
            value["back_end"],
        )
    if value["kind"] == "configure":
        identity = value["identity"]
        return ConfigureStep(
            value["node"],
            value["id"],
            None if identity is None else Identity(*identity),
            values_from_json(value["values"]),
            value["differing"],
        )
    return AttachStep(value["node"], value["after"])


def plan_to_json(plan: Plan) -> dict[str, Any]:
    return {
        "target": to_json(plan.configuration),
        "start": [list(pair) for pair in plan.start],
        "identities": [[name, list(identity)] for name, identity in plan.identities],
        "steps": [step_to_json(step) for step in plan.steps],
    }


def plan_from_json(value: Mapping[str, Any]) -> Plan:
    """Raises ``KeyError``, ``TypeError`` or ``ValueError`` for another JSON value."""
    return Plan(
        from_json(value["target"]),
        tuple((name, node) for name, node in value["start"]),
        tuple((name, Identity(*identity)) for name, identity in value["identities"]),
        tuple(step_from_json(step) for step in value["steps"]),
    )
