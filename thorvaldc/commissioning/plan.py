"""From what is on the bus to what is wanted: steps, in an order that never doubles an address."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import (
    PARKING,
    BusConfiguration,
    NodeConfiguration,
    ParameterValue,
    digest,
    to_json,
    values_from_json,
    values_to_json,
)
from thorvaldc.commissioning.scan_result import (
    DUPLICATE,
    MISSING,
    OK,
    UNEXPECTED,
    FoundDevice,
    ScanResult,
)

LSS_SERIAL, LSS_FASTSCAN, ATTACH_ONE, DOWNLOAD = (
    "lss-serial",
    "lss-fastscan",
    "attach-one",
    "parameters",
)


@dataclass(frozen=True, slots=True)
class AddressStep:
    """Give a device, known by its identity, another id; 255: take it away.

    Precondition: it has ``before``, and nobody has ``after``.  Read-back: after a reset it
    answers with its identity at ``after``, alone.  Inverse: the same with the ids exchanged.
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
            return f"take its id {self.before} from {self.node}"
        where = f"from {self.before} to {self.after}"
        parked = " (parked)" if self.after in PARKING else ""
        return f"move {self.node} {where}{parked}"


@dataclass(frozen=True, slots=True)
class ConfigureStep:
    """Write the values that differ, each read back; save them, reset, read all again.

    Precondition: at ``id`` answers the node, alone and not enabled.  Inverse: the same with the
    values that were there before, which the journal holds.
    """

    node: str
    id: int
    identity: Identity | None
    values: tuple[ParameterValue, ...]
    differing: int | None
    back_end: str = DOWNLOAD

    @property
    def description(self) -> str:
        many = len(self.values) if self.differing is None else self.differing
        unknown = "up to " if self.differing is None else ""
        return f"write {unknown}{many} value{'s' * (many != 1)} of {self.node} (id {self.id})"


@dataclass(frozen=True, slots=True)
class AttachStep:
    """The operator powers one module alone and sets its id with its maker's tool.

    Nothing is written here.  Read-back: exactly one device answers, with the id and of the type.
    Its inverse is the operator's, too.
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
    """``start``: the ids found, by node; ``identities``: those of the nodes where they are known.

    ``strangers``: devices that are none of the robot's.  These and ``problems`` keep it from
    being carried out, ``notes`` do not.
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
        """Of what is wanted, what was found, and the steps."""
        return digest(plan_to_json(self))

    @property
    def ids(self) -> dict[str, set[int]]:
        """Every id that a node has at some time while the plan is carried out."""
        found: dict[str, set[int]] = {name: {node} for name, node in self.start}
        for step in self.steps:
            if isinstance(step, AddressStep):
                found.setdefault(step.node, set()).update((step.before, step.after))
            elif isinstance(step, AttachStep) and step.node in found:
                found[step.node].add(step.after)
        return found


def make_plan(target: BusConfiguration, scan: ScanResult) -> Plan:
    """The steps from what was found to what is wanted.  What stands in the way is said."""
    strangers, problems, notes = _obstacles(target, scan)
    ids = scan.ids()
    identities = {
        e.node: e.found.identity
        for e in scan.entries
        if e.node and e.found is not None and e.found.identity is not None
    }
    moving = [
        node
        for node in target.nodes
        if node.lss and node.name in ids and node.name in identities and ids[node.name] != node.id
    ]
    occupied = Counter(
        e.found.id
        for e in scan.entries
        if e.found is not None and e.found.id is not None and e.found.id != UNCONFIGURED
    )
    attached = _attached(target, scan)
    moves, blocked = _moves(moving, ids, identities, occupied, attached)
    problems += blocked
    losing = [node for node in moving if node.id == UNCONFIGURED]
    steps: list[PlanStep] = [AttachStep(node.name, node.id) for node in attached]
    early = _downloads(losing, scan, ids, identities, ids)
    wanted = {node.name: node.id for node in target.nodes}
    late = [n for n in target.nodes if n.id != UNCONFIGURED and (n.name in ids or n in attached)]
    steps += [*early, *moves, *_downloads(late, scan, ids, identities, wanted)]
    named = [n.name for n in target.nodes if n.name in identities]
    return Plan(
        target,
        tuple((n.name, ids[n.name]) for n in target.nodes if n.name in ids and n.canopen),
        tuple((name, identities[name]) for name in named),
        tuple(steps),
        tuple(strangers),
        tuple(problems),
        tuple(notes),
    )


def _attached(target: BusConfiguration, scan: ScanResult) -> list[NodeConfiguration]:
    """Nodes whose address only their maker's tool can set, and which do not have it."""
    return [n for n in target.nodes if n.by_hand and n.sdo and scan.entry(n.name).verdict != OK]


def _obstacles(
    target: BusConfiguration, scan: ScanResult
) -> tuple[list[str], list[str], list[str]]:
    """Devices of another robot, what else is in the way, and what is not."""
    strangers: list[str] = []
    problems: list[str] = []
    notes: list[str] = []
    at = Counter(scan.ids().values())
    by_hand = bool(_attached(target, scan))
    for entry in scan.entries:
        found = entry.found
        if not entry.node:
            if by_hand and found is not None and _may_be(target, found.identity):
                continue  # one of those that are still to get their addresses
            if found is not None and found.id == UNCONFIGURED and _candidates(target, scan, found):
                problems.append(entry.detail + _suggestion(target, scan, found))
            elif entry.verdict == UNEXPECTED and found is not None and found.identity is not None:
                strangers.append(entry.detail + _suggestion(target, scan, found))
            else:
                problems.append(entry.detail)
            continue
        node = target.node(entry.node)
        if entry.verdict == OK:
            doubt = dict(scan.duplicates).get(node.id) if node.canopen else None
            if doubt:
                problems.append(f"{node.name} (id {node.id}): a duplicate is suspected, {doubt}")
            continue
        if node.by_hand and node.sdo:
            continue
        if entry.verdict == DUPLICATE:
            known = node.lss and found is not None and found.identity is not None
            where = {node.id} if found is None else {node.id, found.id}
            # Where serial numbers tell those apart that share an id, it is no riddle.
            if not known or any(i in where and at[i] < 2 for i, _ in scan.duplicates):
                shared = found.id if found is not None and found.id is not None else node.id
                problems.append(
                    f"{node.name} (id {shared}): a duplicate is suspected, {entry.detail}"
                )
        elif found is None and node.lss:
            problems.append(f"{node.name} is not there: {entry.detail}")
        elif entry.verdict == MISSING:
            notes.append(f"{node.name} is not heard; nothing is written to it")
    return strangers, problems, notes


def _may_be(target: BusConfiguration, identity: Identity | None) -> bool:
    return any(n.by_hand and (identity is None or n.is_like(identity)) for n in target.nodes)


def _candidates(target: BusConfiguration, scan: ScanResult, found: FoundDevice) -> list[str]:
    """The nodes that it may be, which the file names by no serial number."""
    return [
        node.name
        for node in target.nodes
        if node.lss
        and node.serial is None
        and scan.entry(node.name).found is None
        and found.identity is not None
        and node.is_like(found.identity)
    ]


def _suggestion(target: BusConfiguration, scan: ScanResult, found: FoundDevice | None) -> str:
    if found is None or found.identity is None or not found.identity.serial:
        return ""
    serial = f" (serial {found.identity.serial:#x})"
    free = _candidates(target, scan, found)
    if not free:
        return serial
    return f"{serial}; if it is {' or '.join(free)}, write its serial number into the file"


def _moves(
    moving: Sequence[NodeConfiguration],
    ids: Mapping[str, int],
    identities: Mapping[str, Identity],
    occupied: Counter[int],
    attached: Sequence[NodeConfiguration],
) -> tuple[list[AddressStep], list[str]]:
    """One move after the other, each to an id that is free then; a cycle by way of parking."""
    at = {node.name: ids[node.name] for node in moving}
    left = list(moving)
    steps: list[AddressStep] = []
    reserved = {node.id for node in (*moving, *attached)}

    def move(node: NodeConfiguration, after: int) -> None:
        before = at[node.name]
        back_end = LSS_SERIAL if node.serial is not None else LSS_FASTSCAN
        steps.append(AddressStep(node.name, identities[node.name], before, after, back_end))
        occupied[before] -= before != UNCONFIGURED
        occupied[after] += after != UNCONFIGURED
        at[node.name] = after

    while left:
        free = next((n for n in left if n.id == UNCONFIGURED or occupied[n.id] == 0), None)
        if free is not None:
            move(free, free.id)
            left.remove(free)
            continue
        # Somebody in the way that will itself move is parked.
        wanted = {node.id for node in left}
        blocker = next(
            (n for n in left if at[n.name] in wanted and at[n.name] not in PARKING), None
        )
        place = next((p for p in PARKING if occupied[p] == 0 and p not in reserved), None)
        if blocker is None or place is None:
            return steps, [
                f"{n.name} cannot have the id {n.id}: another device that stays has it"
                for n in left
            ]
        move(blocker, place)
    return steps, []


def _downloads(
    nodes: Sequence[NodeConfiguration],
    scan: ScanResult,
    ids: Mapping[str, int],
    identities: Mapping[str, Identity],
    where: Mapping[str, int],
) -> list[ConfigureStep]:
    steps = []
    for node in nodes:
        if not node.sdo or not node.values:
            continue
        differing = None
        read = scan.values.get(node.name)
        if read is not None and ids.get(node.name) == node.id:
            differing = sum(read.get(value.place) != value.value for value in node.values)
            if differing == 0:
                continue
        steps.append(
            ConfigureStep(
                node.name, where[node.name], identities.get(node.name), node.values, differing
            )
        )
    return steps


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
    """Raises ``KeyError``, ``TypeError`` or ``ValueError`` where it is none."""
    from thorvaldc.commissioning.bus_configuration import from_json

    return Plan(
        from_json(value["target"]),
        tuple((name, node) for name, node in value["start"]),
        tuple((name, Identity(*identity)) for name, identity in value["identities"]),
        tuple(step_from_json(step) for step in value["steps"]),
    )
