"""Assigns a node id to each CAN device of a robot, and keeps assigned ids in the lock file.

A node id in the robot file has priority over a node id in the lock file.  A CAN device without a
node id in the robot file and the lock file gets the lowest node id of its range that is free on all
buses of the robot, so that exchanged CAN interfaces are noticed.

The lock file `robot.lock.yaml` of a robot file `robot.yaml` contains the node ids that the compiler
chose.  With the lock file, a CAN device keeps its node id when other devices are added.  Every
command of the compiler reads the lock file, and the command `build` writes it.  The page
`docs/language.md` describes its format.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.compiler.bus import device_sections as sections
from thorvaldc.compiler.bus.device_frames import CHANNEL_DIMENSIONS, channel_names, frames_of
from thorvaldc.compiler.bus.eds_checks import check_against_eds, dictionary_of
from thorvaldc.compiler.source import node as source
from thorvaldc.compiler.source.dimensions import EXPECTED
from thorvaldc.compiler.source.lock_file import ADDRESSES, is_lock, report_invalid
from thorvaldc.compiler.source.node import yaml_text
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Label, Report, Span, did_you_mean
from thorvaldc.model import Channel, FrameDefinition, Node, Robot
from thorvaldc.model.bus import CANOPEN
from thorvaldc.schema import inlined

# Default number of missed heartbeats after which a CANopen node counts as lost, if the module
# document contains no `heartbeat_timeout`.
HEARTBEATS_MISSED = 3


class _Request(NamedTuple):
    """The requested bus and node id of a CAN device in the robot file.

    - ``bus``: name of the bus.
    - ``id``: requested node id, or ``None`` for `auto`.
    - ``serial``: serial number of the device, or ``None``.
    - ``span``: source span of the node id.
    - ``serial_span``: source span of the serial number.
    """

    bus: str
    id: int | None
    serial: str | None
    span: Span
    serial_span: Span


class _UsedIds:
    """Node ids in use, by id space: on each bus, and on any bus of the robot."""

    def __init__(self) -> None:
        self._on_bus: dict[tuple[str, str], set[int]] = {}
        self._on_any: dict[str, set[int]] = {}

    def add(self, bus: str, id_space: str, node_id: int) -> None:
        self._on_bus.setdefault((bus, id_space), set()).add(node_id)
        self._on_any.setdefault(id_space, set()).add(node_id)

    def free(self, bus: str, id_space: str, first: int, last: int) -> int | None:
        """Returns the lowest id that is free on all buses, or else on this bus, or ``None``.

        Ids that differ on all buses show that two CAN interfaces are exchanged.
        """
        for used in (self._on_any.get(id_space, ()), self._on_bus.get((bus, id_space), ())):
            free_id = next((i for i in range(first, last + 1) if i not in used), None)
            if free_id is not None:
                return free_id
        return None


def assign_ids(
    devices: Sequence[sections.Device],
    foreign: Sequence[sections.Placed],
    specs: Sequence[sections.BusSpec],
    sync_period: float,
    lock: Lock,
    report: Report,
    *,
    watchdog: float = math.inf,
) -> list[sections.Placed]:
    """Assigns a node id to each CAN device, and creates the CAN frames of the device.

    - ``devices``: devices without node ids.
    - ``foreign``: foreign devices, which already have node ids.
    - ``specs``: buses of the robot.
    - ``sync_period``: control cycle in s.
    - ``lock``: node ids of the last build.
    - ``watchdog``: longest heartbeat consumer time of a drive in s.

    Reports an error for a CAN device that cannot get a node id, and leaves the device out of the
    result.
    """
    requests = [(device, _request(device, specs, report)) for device in devices]
    used = _UsedIds()
    for other in foreign:
        used.add(other.bus, other.node.id_space, other.node.id)
    for device, request in requests:
        if request.id is not None:
            used.add(request.bus, _id_space(device), request.id)
    pins = _pinned(requests, foreign, lock, report)
    for (bus, id_space, _), pin in pins.items():
        used.add(bus, id_space, pin.id)
    placed = []
    for device, request in requests:
        node_id = _id(device, request, pins, used, report)
        if node_id is None:
            continue
        channels = channel_names(device)
        names = {"id": node_id, "cycle": sync_period, **channels}
        dimensions = {
            "id": EXPECTED["number"],
            "cycle": EXPECTED["time"],
            **dict.fromkeys(channels, CHANNEL_DIMENSIONS.__getitem__),
        }
        named = device._replace(scope=device.scope.with_names(names, dimensions))
        frames = tuple(frames_of(named, node_id, sync_period, report))
        node = _node(named, node_id, request, frames)
        if node.heartbeat_consumer_time is not None:
            consumer_time = min(node.heartbeat_consumer_time, watchdog)
            node = replace(node, heartbeat_consumer_time=consumer_time)
        objects = sections.objects_of(named, node, frames, report)
        dictionary = dictionary_of(named, report)
        if dictionary is not None:
            objects = check_against_eds(named, node, frames, objects, dictionary, report)
            node = replace(node, described=dictionary.described)
        node = replace(node, objects=tuple(entry for entry, _ in objects))
        placed.append(
            sections.Placed(
                device.path,
                request.bus,
                request.span,
                request.serial_span,
                node,
                frames,
                device.can.where,
            )
        )
    return placed


def _request(
    device: sections.Device, specs: Sequence[sections.BusSpec], report: Report
) -> _Request:
    default = specs[0].name
    address = device.address
    if address is None:
        return _Request(default, None, None, device.span, device.span)
    here = address.span
    if not isinstance(address.value, dict):
        node_id = device.scope.evaluate(address)
        is_id = isinstance(node_id, int) and not isinstance(node_id, bool)
        return _Request(default, node_id if is_id else None, None, here, here)
    id_node, serial = address.get("id"), address.get("serial")
    return _Request(
        bus_name(address.get("bus"), specs, report),
        sections.whole_number(id_node),
        str(serial.value) if serial is not None else None,
        id_node.span if id_node is not None else here,
        serial.span if serial is not None else here,
    )


def bus_name(node: source.Node | None, specs: Sequence[sections.BusSpec], report: Report) -> str:
    """Returns the name of the CAN bus to which a device is connected.

    A CAN device without a bus name is on the first bus of the robot file.  If the name of the CAN
    bus is unknown, reports an error and returns the first bus.
    """
    known = [spec.name for spec in specs]
    if node is None:
        return known[0]
    name = str(node.value)
    if name in known:
        return name
    report.add(
        "can-bus-unknown",
        f"there is no bus `{name}`",
        node.span,
        hint=did_you_mean(name, known, sections.listed(known)),
    )
    return known[0]


def _id(
    device: sections.Device,
    request: _Request,
    pins: dict[tuple[str, str, str], Pin],
    used: _UsedIds,
    report: Report,
) -> int | None:
    """Returns the node id of a CAN device.

    Returns ``None`` and reports an error if the requested node id is out of range or no node id is
    free.
    """
    id_space = _id_space(device)
    low, high = _id_range(device, "ids", (1, sections.MASTER_ID))
    if request.id is not None:
        if low <= request.id <= high:
            return request.id
        report.add(
            "can-id-range",
            f"`{device.path}` has the id {request.id}; this device allows {low} to {high}",
            request.span,
            labels=[Label((device.can.get("ids") or device.can).where, "stated here")],
        )
        return None
    pin = pins.get((request.bus, id_space, device.path))
    if pin is not None:
        return pin.id
    first, last = _id_range(device, "auto_ids", (low, high))
    free_id = used.free(request.bus, id_space, first, last)
    if free_id is None:
        report.add(
            "can-ids-exhausted",
            f"no id is free for `{device.path}`: {first} to {last} are all in use",
            request.span,
            labels=[Label((device.can.get("auto_ids") or device.can).where, "stated here")],
            hint=f"give it one of {low} to {high} with `can: ...`, or use another bus",
        )
        return None
    used.add(request.bus, id_space, free_id)
    return free_id


def _pinned(
    requests: Sequence[tuple[sections.Device, _Request]],
    foreign: Sequence[sections.Placed],
    lock: Lock,
    report: Report,
) -> dict[tuple[str, str, str], Pin]:
    """Returns the valid node ids in the lock file, by the tuple (bus, id space, module).

    Reports a diagnostic for each invalid or unused node id of the lock file.
    """
    if not lock:
        return {}
    owners: dict[tuple[str, str, int], tuple[str, Span]] = {}
    for other in foreign:
        owners[other.bus, other.node.id_space, other.node.id] = (other.path, other.span)
    for device, request in requests:
        if request.id is not None:
            key = (request.bus, _id_space(device), request.id)
            owners.setdefault(key, (device.path, request.span))
    kept: dict[tuple[str, str, str], Pin] = {}
    for device, request in requests:
        id_space = _id_space(device)
        pin = lock.get((request.bus, id_space, device.path))
        if pin is None:
            continue
        if request.id is not None:
            if request.id != pin.id:
                report.add(
                    "can-lock-unused",
                    f"`{device.path}` has the id {request.id}; the lock file has {pin.id} for it",
                    request.span,
                    labels=[Label(pin.span, "pinned here")],
                    hint="the id in the robot's file is used, and the next build updates the "
                    "lock file; a device that still has the old id must be given the new one",
                )
            continue
        low, high = _id_range(device, "ids", (1, sections.MASTER_ID))
        owner = owners.setdefault((request.bus, id_space, pin.id), (device.path, pin.span))
        if not low <= pin.id <= high:
            report.add(
                "can-lock-conflict",
                f"the lock file has the id {pin.id} for `{device.path}`; this device can have "
                f"{low} to {high}",
                request.span,
                labels=[Label(pin.span, "pinned here")],
                hint="remove the line from the lock file to choose another id",
            )
        elif owner[1] is not pin.span:
            report.add(
                "can-lock-conflict",
                f"`{owner[0]}` has the id {pin.id} on the bus `{request.bus}`, and the lock file "
                f"gives the same id to `{device.path}`",
                owner[1],
                labels=[Label(pin.span, "pinned here"), Label(request.span, f"`{device.path}`")],
                hint=f"give `{owner[0]}` another id, or remove the line from the lock file "
                f"to choose a new id for `{device.path}`",
            )
        else:
            kept[request.bus, id_space, device.path] = pin
    return kept


def _id_space(device: sections.Device) -> str:
    return device.scope.text(device.can.get("id_space"), CANOPEN)


def _id_range(device: sections.Device, key: str, default: tuple[int, int]) -> tuple[int, int]:
    ends = [sections.integer(device.scope, node, 0) for node in items(device.can.get(key))]
    return (ends[0], ends[1]) if len(ends) == 2 else default


def _node(
    device: sections.Device,
    node_id: int,
    request: _Request,
    frames: Sequence[FrameDefinition],
) -> Node:
    scope, can = device.scope, device.can
    wired = {wire.channel: wire.actuator.name for wire in reversed(device.wires)}

    stated = Section(can, inlined("module")["properties"]["can"], scope)
    beats = [f.period for f in frames if f.kind == "heartbeat" and f.period is not None]
    return Node(
        device.name,
        device.path,
        scope.text(can.get("protocol")),
        node_id,
        _id_space(device),
        stated["vendor_id"],
        request.serial,
        tuple(
            Channel(name, scope.text(node.get("role")), wired.get(name))
            for name, node in entries(device.channels).items()
        ),
        tuple(
            (name, value)
            for name, node in entries(can.get("properties")).items()
            if (value := scope.scalar(node)) is not None
        ),
        device.span,
        automatic=request.id is None,
        product_code=stated["product_code"],
        revision_number=stated["revision_number"],
        device_type=stated["device_type"],
        lss=scope.boolean(can.get("lss"), False),
        heartbeat_timeout=stated.get("heartbeat_timeout", HEARTBEATS_MISSED * beats[0])
        if beats
        else None,
        heartbeat_consumer_time=stated["heartbeat_consumer_time"],
        command_watchdog=stated["command_watchdog"],
        watchdog_coasts=scope.boolean(can.get("watchdog_coasts"), False),
        bitrates=tuple(map(round, stated["bitrates"])),
    )


# -- the lock file ----------------------------------------------------------------------


class Pin(NamedTuple):
    id: int
    span: Span


LockKey = tuple[str, str, str]
"""Bus, id space and module of a node id in the lock file."""
Lock = dict[LockKey, Pin]


def read_lock(document: source.Node, report: Report) -> Lock:
    """Returns the node ids in a lock file, and reports an error for each invalid node id."""
    if not is_lock(document, report):
        return {}

    def entries(node: source.Node | None) -> Iterator[tuple[str, source.Node]]:
        if node is not None and isinstance(node.value, dict):
            yield from node.value.items()
        elif node is not None:
            report_invalid("expected a mapping", node, report)

    lock: Lock = {}
    for bus, spaces in entries(document.get(ADDRESSES)):
        for id_space, modules in entries(spaces):
            for module, node in entries(modules):
                node_id = sections.whole_number(node)
                if node_id is not None:
                    lock[bus, id_space, module] = Pin(node_id, node.where)
                else:
                    message = f"the id of `{module}` must be a whole number"
                    report_invalid(message, node, report)
    return lock


def chosen_ids(robot: Robot) -> dict[LockKey, int]:
    """Returns the node ids that the compiler chose."""
    return {
        (bus.name, node.id_space, node.module): node.id
        for bus in robot.buses
        for node in bus.nodes
        if node.automatic
    }


def address_lines(ids: Mapping[LockKey, int]) -> Iterator[str]:
    """Yields the lines of the node ids in a lock file."""
    for bus in dict.fromkeys(key[0] for key in ids):
        yield f"  {yaml_text(bus)}:\n"
        for id_space in dict.fromkeys(key[1] for key in ids if key[0] == bus):
            yield f"    {yaml_text(id_space)}:\n"
            for (*space, module), node_id in ids.items():
                if space == [bus, id_space]:
                    yield f"      {yaml_text(module)}: {node_id}\n"
