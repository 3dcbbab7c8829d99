"""Plans a flash: orders the steps from the scanned bus to the required configuration.

Two nodes must never share an id, not even for a moment, because SDO could not address either of
them.  So each step moves one node to an id that is free at that time.  Draw an arrow from each node
to the node that has its required id now:

    chain   A(1->2) --> B(2->3) --> (3 is free)      move B to 3, then A to 2
    cycle   A(1->2) --> B(2->1) --> A                no id is free: park A at 112; then B to 1,
                                                     then A from 112 to 2

Required ids are distinct, so the arrows form chains and cycles.  A chain unwinds from its free
end.  A cycle becomes a chain when one of its nodes is parked, so one parking id at a time is
enough.  A chain that ends at a node that keeps its id makes the plan impossible.  If new nodes
share an id at the start, that id is free as soon as all of them have moved.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import PARKING, BusConfiguration, NodeConfiguration
from thorvaldc.commissioning.plan import (
    LSS_FASTSCAN,
    LSS_SERIAL,
    AddressStep,
    AttachStep,
    ConfigureStep,
    Plan,
    PlanStep,
)
from thorvaldc.commissioning.scan_result import (
    DUPLICATE,
    MISSING,
    OK,
    UNEXPECTED,
    FoundDevice,
    ScanEntry,
    ScanResult,
)


def make_plan(configuration: BusConfiguration, scan: ScanResult) -> Plan:
    """Returns the steps from the scanned bus to the configuration, and what prevents them."""
    strangers, problems, notes = _find_obstacles(configuration, scan)
    ids = scan.ids()
    identities = {
        entry.node: entry.device.identity
        for entry in scan.entries
        if entry.node and entry.device is not None and entry.device.identity is not None
    }
    moving = [
        node
        for node in configuration.nodes
        if node.lss and node.name in ids and node.name in identities and ids[node.name] != node.id
    ]
    occupied = Counter(
        entry.device.id
        for entry in scan.entries
        if entry.device is not None
        and entry.device.id is not None
        and entry.device.id != UNCONFIGURED
        and entry.device.id is not None
        and entry.device.id != UNCONFIGURED
    )
    by_hand = _nodes_set_by_hand(configuration, scan)
    moves, blocked = _address_steps(moving, ids, identities, occupied, by_hand)
    problems += blocked
    steps: list[PlanStep] = [AttachStep(node.name, node.id) for node in by_hand]
    # A node that loses its id gets its values first; all others after the moves.
    losing_id = [node for node in moving if node.id == UNCONFIGURED]
    early = _configure_steps(losing_id, scan, ids, identities, ids)
    required_ids = {node.name: node.id for node in configuration.nodes}
    with_id = [
        node
        for node in configuration.nodes
        if node.id != UNCONFIGURED and (node.name in ids or node in by_hand)
    ]
    late = _configure_steps(with_id, scan, ids, identities, required_ids)
    steps += [*early, *moves, *late]
    return Plan(
        configuration,
        tuple(
            (node.name, ids[node.name])
            for node in configuration.nodes
            if node.name in ids and node.canopen
        ),
        tuple(
            (node.name, identities[node.name])
            for node in configuration.nodes
            if node.name in identities
        ),
        tuple(steps),
        tuple(strangers),
        tuple(problems),
        tuple(notes),
    )


def _nodes_set_by_hand(
    configuration: BusConfiguration, scan: ScanResult
) -> list[NodeConfiguration]:
    """Nodes without their id, which only the maker's tool can set."""
    return [
        node
        for node in configuration.nodes
        if node.by_hand and node.sdo and scan.entry(node.name).verdict != OK
    ]


# -- obstacles ----------------------------------------------------------------------------------


def _find_obstacles(
    configuration: BusConfiguration, scan: ScanResult
) -> tuple[list[str], list[str], list[str]]:
    """Returns strangers, problems and notes, as in ``Plan``."""
    strangers: list[str] = []
    problems: list[str] = []
    notes: list[str] = []
    for entry in scan.entries:
        if not entry.node:
            stranger, problem = _unknown_device(configuration, scan, entry)
            strangers += stranger
            problems += problem
            continue
        node = configuration.node(entry.node)
        if entry.verdict == OK:
            evidence = dict(scan.duplicates).get(node.id) if node.canopen else None
            if evidence:
                problems.append(f"{node.name} (id {node.id}): a duplicate is suspected, {evidence}")
            continue
        if node.by_hand and node.sdo:
            continue
        if entry.verdict == DUPLICATE:
            problems += _duplicate_problem(node, entry, scan)
        elif entry.device is None and node.lss:
            problems.append(f"{node.name} is missing: {entry.detail}")
        elif entry.verdict == MISSING:
            notes.append(f"no frame of {node.name} was received; nothing is written to it")
    return strangers, problems, notes


def _unknown_device(
    configuration: BusConfiguration, scan: ScanResult, entry: ScanEntry
) -> tuple[list[str], list[str]]:
    """Returns a stranger or a problem for a device that the file does not name."""
    device = entry.device
    if _nodes_set_by_hand(configuration, scan) and device is not None:
        # It may be a node whose id the operator still has to set.
        identity = device.identity
        if any(
            node.by_hand and (identity is None or node.is_like(identity))
            for node in configuration.nodes
        ):
            return [], []
    text = entry.detail + _suggest_serial(configuration, scan, device)
    if (
        device is not None
        and device.id == UNCONFIGURED
        and _candidates(configuration, scan, device)
    ):
        return [], [text]
    if entry.verdict == UNEXPECTED and device is not None and device.identity is not None:
        return [text], []
    return [], [entry.detail]


def _duplicate_problem(node: NodeConfiguration, entry: ScanEntry, scan: ScanResult) -> list[str]:
    device = entry.device
    at = Counter(scan.ids().values())
    known = node.lss and device is not None and device.identity is not None
    ids = {node.id} if device is None else {node.id, device.id}
    # Nodes that share an id are no problem if the scan knows all of them by serial number.
    if known and not any(i in ids and at[i] < 2 for i, _ in scan.duplicates):
        return []
    shared = device.id if device is not None and device.id is not None else node.id
    return [f"{node.name} (id {shared}): a duplicate is suspected, {entry.detail}"]


def _candidates(
    configuration: BusConfiguration, scan: ScanResult, device: FoundDevice
) -> list[str]:
    """Missing nodes that the device can be: the file contains no serial number for them."""
    return [
        node.name
        for node in configuration.nodes
        if node.lss
        and node.serial is None
        and scan.entry(node.name).device is None
        and device.identity is not None
        and node.is_like(device.identity)
    ]


def _suggest_serial(
    configuration: BusConfiguration, scan: ScanResult, device: FoundDevice | None
) -> str:
    if device is None or device.identity is None or not device.identity.serial:
        return ""
    serial = f" (serial {device.identity.serial:#x})"
    candidates = _candidates(configuration, scan, device)
    if not candidates:
        return serial
    return f"{serial}; if it is {' or '.join(candidates)}, write its serial number into the file"


# -- steps --------------------------------------------------------------------------------------


def _address_steps(
    moving: Sequence[NodeConfiguration],
    ids: Mapping[str, int],
    identities: Mapping[str, Identity],
    occupied: Counter[int],
    by_hand: Sequence[NodeConfiguration],
) -> tuple[list[AddressStep], list[str]]:
    """Returns the moves, each to a free id, and a problem for each node that cannot move.

    ``occupied`` counts the devices at each id; it is updated.
    """
    present = {node.name: ids[node.name] for node in moving}
    remaining = list(moving)
    steps: list[AddressStep] = []
    reserved = {node.id for node in (*moving, *by_hand)}

    def move(node: NodeConfiguration, after: int) -> None:
        before = present[node.name]
        back_end = LSS_SERIAL if node.serial is not None else LSS_FASTSCAN
        steps.append(AddressStep(node.name, identities[node.name], before, after, back_end))
        occupied[before] -= before != UNCONFIGURED
        occupied[after] += after != UNCONFIGURED
        present[node.name] = after

    while remaining:
        movable = next(
            (node for node in remaining if node.id == UNCONFIGURED or occupied[node.id] == 0), None
        )
        if movable is not None:
            move(movable, movable.id)
            remaining.remove(movable)
            continue
        # Only cycles are left, and chains that end at a node that stays: park a node of a cycle.
        required = {node.id for node in remaining}
        blocker = next(
            (
                node
                for node in remaining
                if present[node.name] in required and present[node.name] not in PARKING
            ),
            None,
        )
        parking_id = next((p for p in PARKING if occupied[p] == 0 and p not in reserved), None)
        if blocker is None or parking_id is None:
            return steps, [
                f"{node.name} cannot get the id {node.id}: a device that keeps its id has it"
                for node in remaining
            ]
        move(blocker, parking_id)
    return steps, []


def _configure_steps(
    nodes: Sequence[NodeConfiguration],
    scan: ScanResult,
    ids: Mapping[str, int],
    identities: Mapping[str, Identity],
    ids_then: Mapping[str, int],
) -> list[ConfigureStep]:
    """Returns the steps for nodes with differing values; ``ids_then``: ids at that time."""
    steps = []
    for node in nodes:
        if not node.sdo or not node.values:
            continue
        differing = None
        present = scan.values.get(node.name)
        if present is not None and ids.get(node.name) == node.id:
            differing = sum(present.get(value.key) != value.value for value in node.values)
            if differing == 0:
                continue
        steps.append(
            ConfigureStep(
                node.name, ids_then[node.name], identities.get(node.name), node.values, differing
            )
        )
    return steps
