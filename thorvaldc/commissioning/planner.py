"""The plan of a flash: its steps from the scanned bus to the required configuration.

Two nodes must never share a node id, because SDO cannot address two nodes with the same id.  Each
step of the commissioning plan changes the id of one node to an id that no other node has at that
time.  In the diagram A(1->2) means that node A has the id 1 and requires the id 2.  An arrow leads
from each node to the node that has the required id:

    chain   A(1->2) --> B(2->3) --> (3 is free)      move B to 3, then A to 2
    cycle   A(1->2) --> B(2->1) --> A                no id is free: park A at 112; then B to 1,
                                                     then A from 112 to 2

The arrows form chains and cycles, because all required node ids are different.  In a chain of
nodes, the first node to change is the node whose required id is free.  A cycle of nodes becomes a
chain when one node gets a temporary node id (parking id).  One temporary node id at a time is
sufficient.  The plan is impossible if a required node id belongs to a device whose id is not
changed.  If several new nodes share a node id, the id is free when all of these nodes have other
ids.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning import bus_configuration, scan_result
from thorvaldc.commissioning.plan import (
    LSS_FASTSCAN,
    LSS_SERIAL,
    AddressStep,
    AttachStep,
    ConfigureStep,
    Plan,
    PlanStep,
)
from thorvaldc.commissioning.scan_result import FoundDevice, ScanEntry, ScanResult

# -- planning --------------------------------------------------------------------------------------


def make_plan(configuration: bus_configuration.BusConfiguration, scan: ScanResult) -> Plan:
    """Returns the commissioning plan that changes the scanned nodes to the required configuration.

    ``Plan.problems`` contains the reasons why the plan cannot be executed.
    """
    strangers, problems, notes = _find_obstacles(configuration, scan)
    ids = scan.ids()
    identities = {
        entry.node: entry.identity
        for entry in scan.entries
        if entry.node and entry.identity is not None
    }
    moving = [
        node
        for node in configuration.nodes
        if node.lss and node.name in ids and node.name in identities and ids[node.name] != node.id
    ]
    problems += [
        f"{node.name}: its module states no vendor_id and product_code, so it gets no id by LSS"
        for node in moving
        if not node.states_product
    ]
    occupied = Counter(
        entry.device_id
        for entry in scan.entries
        if entry.device_id is not None and entry.device_id != UNCONFIGURED
    )
    by_hand = _nodes_set_by_hand(configuration, scan)
    moves, blocked = _address_steps(moving, ids, identities, occupied, by_hand)
    problems += blocked
    steps: list[PlanStep] = [AttachStep(node.name, node.id) for node in by_hand]
    # The object values of a node are written before the node ids change if a step removes the node
    # id of the node.  The object values of all other nodes are written after the node ids have
    # changed.
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
    configuration: bus_configuration.BusConfiguration, scan: ScanResult
) -> list[bus_configuration.NodeConfiguration]:
    """Returns the nodes whose id must be set with the tool of the manufacturer."""
    return [
        node
        for node in configuration.nodes
        if node.by_hand and node.sdo and scan.entry(node.name).verdict != scan_result.OK
    ]


# -- obstacles ----------------------------------------------------------------------------------


def _find_obstacles(
    configuration: bus_configuration.BusConfiguration, scan: ScanResult
) -> tuple[list[str], list[str], list[str]]:
    """Returns the unknown devices (strangers), the problems and the notes of a commissioning
    plan."""
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
        if node.drive and not node.canopen:
            notes.append(f"{node.name} is no CANopen node; its id and settings are not written")
        if entry.verdict == scan_result.OK:
            evidence = dict(scan.duplicates).get(node.id) if node.canopen else None
            if evidence:
                problems.append(f"{node.name} (id {node.id}): a duplicate is suspected, {evidence}")
            continue
        if node.by_hand and node.sdo:
            continue
        if entry.verdict == scan_result.DUPLICATE:
            problems += _duplicate_problem(node, entry, scan)
        elif entry.device is None and node.lss:
            problems.append(f"{node.name} is missing: {entry.detail}")
        elif entry.device is not None and not entry.device.has_type_of(node):
            problems.append(f"{node.name}: {entry.detail}")
        elif entry.verdict == scan_result.MISSING:
            notes.append(f"no frame of {node.name} was received; nothing is written to it")
    return strangers, problems, notes


def is_stranger(
    configuration: bus_configuration.BusConfiguration, scan: ScanResult, entry: ScanEntry
) -> bool:
    """Returns ``True`` if a device, by its identity, is none of the devices in the robot file."""
    if entry.node or entry.verdict != scan_result.UNEXPECTED:
        return False
    device = entry.device
    if device is None or device.identity is None or _may_be_set_by_hand(configuration, scan, entry):
        return False
    return device.id != UNCONFIGURED or not _candidates(configuration, scan, device)


def _may_be_set_by_hand(
    configuration: bus_configuration.BusConfiguration, scan: ScanResult, entry: ScanEntry
) -> bool:
    """Returns ``True`` if an unknown device may be a node whose id the operator must still set."""
    identity = entry.identity
    return (
        entry.device is not None
        and bool(_nodes_set_by_hand(configuration, scan))
        and any(
            node.by_hand and (identity is None or node.is_like(identity))
            for node in configuration.nodes
        )
    )


def _unknown_device(
    configuration: bus_configuration.BusConfiguration, scan: ScanResult, entry: ScanEntry
) -> tuple[list[str], list[str]]:
    """Returns the unknown devices (strangers) and the problems for a device that is not in the
    robot file."""
    if _may_be_set_by_hand(configuration, scan, entry):
        return [], []
    device = entry.device
    text = entry.detail + _suggest_serial(configuration, scan, device)
    if is_stranger(configuration, scan, entry):
        return [text], []
    is_candidate = (
        device is not None
        and device.id == UNCONFIGURED
        and bool(_candidates(configuration, scan, device))
    )
    return [], [text if is_candidate else entry.detail]


def _duplicate_problem(
    node: bus_configuration.NodeConfiguration, entry: ScanEntry, scan: ScanResult
) -> list[str]:
    device = entry.device
    at = Counter(scan.ids().values())
    known = node.lss and entry.identity is not None
    ids = {node.id} if device is None else {node.id, device.id}
    # A shared node id is not a problem if LSS has found all devices with this node id.
    if known and not any(i in ids and at[i] < 2 for i, _ in scan.duplicates):
        return []
    shared = node.id if entry.device_id is None else entry.device_id
    return [f"{node.name} (id {shared}): a duplicate is suspected, {entry.detail}"]


def _candidates(
    configuration: bus_configuration.BusConfiguration, scan: ScanResult, device: FoundDevice
) -> list[str]:
    """Returns the names of the missing nodes to which an unknown device can be assigned.

    Any device with a matching identity can be assigned to a node without serial number in the robot
    file.
    """
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
    configuration: bus_configuration.BusConfiguration, scan: ScanResult, device: FoundDevice | None
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
    moving: Sequence[bus_configuration.NodeConfiguration],
    ids: Mapping[str, int],
    identities: Mapping[str, Identity],
    occupied: Counter[int],
    by_hand: Sequence[bus_configuration.NodeConfiguration],
) -> tuple[list[AddressStep], list[str]]:
    """Returns the steps that change node ids, and a problem for each node whose id cannot be
    changed.

    Each step gives a node a free node id.  ``occupied``: number of devices at each node id, which
    the function updates.
    """
    present = {node.name: ids[node.name] for node in moving}
    remaining = list(moving)
    steps: list[AddressStep] = []
    reserved = {node.id for node in (*moving, *by_hand)}

    def move(node: bus_configuration.NodeConfiguration, after: int) -> None:
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
        # If no required node id is free, one node of a cycle gets a temporary node id.
        required = {node.id for node in remaining}
        blocker = next(
            (
                node
                for node in remaining
                if present[node.name] in required
                and present[node.name] not in bus_configuration.PARKING
            ),
            None,
        )
        parking_id = next(
            (p for p in bus_configuration.PARKING if occupied[p] == 0 and p not in reserved), None
        )
        if blocker is None or parking_id is None:
            return steps, [
                f"{node.name} cannot get the id {node.id}: a device that keeps its id has it"
                for node in remaining
            ]
        move(blocker, parking_id)
    return steps, []


def _configure_steps(
    nodes: Sequence[bus_configuration.NodeConfiguration],
    scan: ScanResult,
    ids: Mapping[str, int],
    identities: Mapping[str, Identity],
    ids_then: Mapping[str, int],
) -> list[ConfigureStep]:
    """Returns the steps that write object values to the nodes with differing values.

    ``ids``: scanned node id of each node.  ``ids_then``: node id of each node at the time when the
    object values are written.
    """
    steps = []
    for node in nodes:
        if not node.sdo or not node.values:
            continue
        differing = None
        present = scan.values.get(node.name)
        if present is not None and ids.get(node.name) == node.id:
            differing = len(bus_configuration.differing_values(node.values, present))
            if differing == 0:
                continue
        steps.append(
            ConfigureStep(
                node.name, ids_then[node.name], identities.get(node.name), node.values, differing
            )
        )
    return steps
