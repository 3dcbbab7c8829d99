"""The plan of a flash: its steps in order, as JSON and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning import bus_configuration
from thorvaldc.diagnostics.text_layout import text_table
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

    kind = "address"
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
        parked = " (parked)" if self.after in bus_configuration.PARKING else ""
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

    kind = "configure"
    node: str
    id: int
    identity: Identity | None
    values: tuple[bus_configuration.ParameterValue, ...]
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

    kind = "attach"
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

    configuration: bus_configuration.BusConfiguration
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
        return bus_configuration.digest(plan_to_json(self))

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


_STEPS = {step.kind: step for step in (AddressStep, ConfigureStep, AttachStep)}


def step_to_json(step: PlanStep) -> dict[str, Any]:
    return {"kind": step.kind, **asdict(step)}


def step_from_json(value: Mapping[str, Any]) -> PlanStep:
    fields = {name: member for name, member in value.items() if name != "kind"}
    step: PlanStep = typed_value(_STEPS[value["kind"]], fields)
    if isinstance(step, ConfigureStep):
        bus_configuration.check_values(step.values)
        _check_device(step.identity, step.id)
    elif isinstance(step, AddressStep):
        _check_device(step.identity, step.before, step.after)
    else:
        _check_device(None, step.after)
    return step


def _check_device(identity: Identity | None, *node_ids: int) -> None:
    for node_id in node_ids:
        bus_configuration.check_node_id(node_id)
    if identity is not None and not all(0 <= number < 1 << 32 for number in identity):
        raise ValueError(f"{identity} is no identity")


def plan_to_json(plan: Plan) -> dict[str, Any]:
    return {
        "target": asdict(plan.configuration),
        "start": plan.start,
        "identities": plan.identities,
        "steps": [step_to_json(step) for step in plan.steps],
    }


def plan_from_json(value: Mapping[str, Any]) -> Plan:
    """Converts the JSON form of a commissioning plan into a ``Plan``.

    Raises ``KeyError``, ``TypeError`` or ``ValueError`` if the JSON value is not a commissioning
    plan.
    """
    plan = Plan(
        bus_configuration.from_json(value["target"]),
        typed_value(tuple[tuple[str, int], ...], value["start"]),
        typed_value(tuple[tuple[str, Identity], ...], value["identities"]),
        tuple(step_from_json(step) for step in value["steps"]),
    )
    _check_device(None, *(node_id for _, node_id in plan.start))
    for _, identity in plan.identities:
        _check_device(identity)
    return plan


# -- as text ---------------------------------------------------------------------------------------


def plan_table(plan: Plan, width: int | None = None) -> str:
    """Returns the steps, problems, notes and hash of a commissioning plan as text.

    ``width``: number of columns of the terminal, or ``None`` for one line per step.
    """
    lines = []
    if plan.steps:
        rows = [("step", "how", "what")]
        rows += [
            (str(number), step.back_end, step.description)
            for number, step in enumerate(plan.steps, 1)
        ]
        lines.append(text_table(rows, width))
    lines += [f"problem: {problem}" for problem in (*plan.strangers, *plan.problems)]
    lines += [f"note: {note}" for note in plan.notes]
    if not plan.steps and not plan.problems and not plan.strangers:
        lines.append("the bus matches the robot file")
    lines.append(f"plan {plan.hash}")
    return "\n".join(lines)


def plan_as_json(plan: Plan) -> dict[str, Any]:
    """Returns a commissioning plan as JSON values."""
    return {
        "hash": plan.hash,
        "robot": plan.configuration.robot,
        "bus": plan.configuration.bus,
        "steps": [{**step_to_json(step), "words": step.description} for step in plan.steps],
        "strangers": list(plan.strangers),
        "problems": list(plan.problems),
        "notes": list(plan.notes),
    }
