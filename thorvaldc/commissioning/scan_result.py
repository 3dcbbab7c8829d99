"""Result of a scan: the devices on the bus, the verdict on each node, and both as text."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can.canopen import HEARTBEAT, HIGHEST_NODE_ID
from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import BusConfiguration, NodeConfiguration
from thorvaldc.diagnostics.text_layout import text_table

OK, MISSING, UNEXPECTED = "ok", "missing", "unexpected"
DUPLICATE, WRONG_IDENTITY, WITHOUT_ID = "duplicate-suspected", "wrong-identity", "unconfigured"


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device that a scan has found on the bus.

    - ``id``: node id, 255 for a device without node id, ``None`` if it is not a CANopen device;
    - ``identity``: identity (object 0x1018), ``None`` if unknown;
    - ``device_type``: device type (object 0x1000), ``None`` if unknown;
    - ``texts``: device name, hardware version and software version.
    """

    id: int | None
    identity: Identity | None = None
    device_type: int | None = None
    texts: tuple[str, ...] = ()

    @property
    def id_text(self) -> str:
        return "no id" if self.id == UNCONFIGURED else f"the id {self.id}"

    def has_type_of(self, node: NodeConfiguration) -> bool:
        """Returns ``True`` if the device type (object 0x1000) matches the robot file.

        The type may be unknown for a device at another id than its own, and for one without an id,
        which cannot be asked.
        """
        if node.device_type is None or not node.sdo or self.device_type == node.device_type:
            return True
        return self.device_type is None and (self.id != node.id or self.id == UNCONFIGURED)


@dataclass(frozen=True, slots=True)
class ScanEntry:
    """Verdict of a scan on a node of the robot file or on an unknown device.

    - ``node``: name of the node, empty for a device that is not in the robot file;
    - ``verdict``: ``ok``, ``missing``, ``unexpected`` or another verdict of this module;
    - ``wanted_id``: node id in the robot file;
    - ``device``: device for this node, ``None`` if no device was found;
    - ``detail``: reason for the verdict.
    """

    node: str
    verdict: str
    wanted_id: int | None
    device: FoundDevice | None
    detail: str = ""

    @property
    def device_id(self) -> int | None:
        """Node id of the device; ``None`` without a device."""
        return None if self.device is None else self.device.id

    @property
    def identity(self) -> Identity | None:
        """Identity of the device; ``None`` without a device."""
        return None if self.device is None else self.device.identity


@dataclass(frozen=True, slots=True)
class ScanResult:
    """Result of a scan for CANopen nodes.

    - ``active``: ``True`` if the scan has sent requests;
    - ``entries``: verdicts on all nodes and on unknown devices;
    - ``masters``: descriptions of frames of another master;
    - ``enabled``: names of drives that may move, with the reason for each drive;
    - ``duplicates``: node ids that two devices may have, with the reason for each node id;
    - ``values``: object values by node, ``None`` for an object that could not be read;
    - ``frames``: number of received frames.
    """

    active: bool
    entries: tuple[ScanEntry, ...]
    masters: tuple[str, ...] = ()
    enabled: tuple[tuple[str, str], ...] = ()
    duplicates: tuple[tuple[int, str], ...] = ()
    values: dict[str, dict[tuple[int, int], int | None]] = field(default_factory=dict)
    frames: int = 0

    def entry(self, node: str) -> ScanEntry:
        """Returns the scan entry of the node ``node``.

        Raises ``KeyError`` if the scan result has no node ``node``.
        """
        for entry in self.entries:
            if entry.node == node:
                return entry
        raise KeyError(node)

    def ids(self) -> dict[str, int]:
        """Returns the scanned node ids by name of the node.

        A node without node id has the number 255.
        """
        return {
            entry.node: entry.device_id
            for entry in self.entries
            if entry.node and entry.device_id is not None
        }

    def as_json(self) -> dict[str, Any]:
        return {
            "active": self.active,
            "nodes": [_entry_json(entry) for entry in self.entries],
            "masters": list(self.masters),
            "enabled": [list(pair) for pair in self.enabled],
            "duplicates": [list(pair) for pair in self.duplicates],
        }


def _entry_json(entry: ScanEntry) -> dict[str, Any]:
    device = entry.device
    return {
        "node": entry.node or None,
        "verdict": entry.verdict,
        "wanted_id": entry.wanted_id,
        "found_id": None if device is None or device.id == UNCONFIGURED else device.id,
        "identity": None if device is None or device.identity is None else list(device.identity),
        "device_type": None if device is None else device.device_type,
        "texts": [] if device is None else list(device.texts),
        "detail": entry.detail,
    }


def identity_text(identity: Identity | None) -> str:
    """Returns the identity of a device as text.

    An example of the text is ``vendor 0x469, product 0x402, revision 0x1, serial 0x101``.
    """
    if identity is None:
        return "a device of unknown identity"
    vendor, product, revision, serial = identity
    return numbers_text(vendor, product, revision, serial or None)


def numbers_text(*numbers: int | None) -> str:
    """Returns the known numbers of an identity as text, in the order of ``Identity``."""
    named = zip(Identity._fields, numbers, strict=True)
    return ", ".join(f"{name} {number:#x}" for name, number in named if number is not None)


def scan_table(scan: ScanResult, width: int | None = None) -> str:
    """Returns a text table with one row for each node and each unknown device.

    The columns of the scan table are the verdict, the name of the node, the node id in the robot
    file, the node id on the bus, and the description of the device.
    ``width``: number of columns of the terminal, or ``None`` for one line per row.
    """
    header = ("verdict", "node", "id", "found", "device")
    return text_table([header, *(_scan_row(entry) for entry in scan.entries)], width)


def _scan_row(entry: ScanEntry) -> tuple[str, ...]:
    device = entry.device
    found_id, description = "", ""
    if device is not None:
        if device.id is not None:
            found_id = "none" if device.id == UNCONFIGURED else str(device.id)
        if device.identity is not None:
            description = identity_text(device.identity)
        if any(device.texts):
            description += f" ({', '.join(text for text in device.texts if text)})"
    details = "; ".join(part for part in (description, entry.detail) if part)
    wanted_id = "" if entry.wanted_id is None else str(entry.wanted_id)
    return (entry.verdict, entry.node or "-", wanted_id, found_id, details)


def scan_notes(scan: ScanResult) -> list[str]:
    """Returns notes for the user about duplicate node ids, other CANopen masters and enabled
    drives."""
    notes = [
        f"two devices may have the id {node_id}: {evidence}"
        for node_id, evidence in scan.duplicates
    ]
    if scan.masters:
        notes.append(f"another master is on the bus: {', '.join(scan.masters)}")
    notes += [f"{name} may move: {reason}" for name, reason in scan.enabled]
    if not scan.active:
        notes.append("the scan only listened; --active sends a request to every node")
    return notes


# -- evaluation ------------------------------------------------------------------------------------


@dataclass
class Findings:
    """Devices and duplicate node ids that a scan has found on the CAN bus.

    - ``evidence``: reason to suspect two devices with one node id, by node id;
    - ``by_id``: devices that have responded to SDO requests, by node id;
    - ``by_name``: devices that LSS has found by identity, by name of the node;
    - ``without_id``: devices without node id that an LSS fastscan has found.
    """

    evidence: dict[int, str] = field(default_factory=dict)
    by_id: dict[int, FoundDevice] = field(default_factory=dict)
    by_name: dict[str, FoundDevice] = field(default_factory=dict)
    without_id: list[FoundDevice] = field(default_factory=list)


class ScanEvaluation:
    """Compares the findings of a scan with the required configuration.

    ``received``: reception times (s) of the CAN frames by key.  ``known``: CAN identifiers
    in the CAN map of the robot.
    """

    def __init__(
        self,
        configuration: BusConfiguration,
        findings: Findings,
        received: Mapping[int, list[float]],
        known: set[int],
    ) -> None:
        self.configuration = configuration
        self.findings = findings
        self._received = received
        self._known = known

    def passive_entries(self) -> list[ScanEntry]:
        """Returns the verdict on each node after a passive scan, which only receives CAN frames."""
        entries = []
        for node in self.configuration.nodes:
            evidence = self.findings.evidence.get(node.id) if node.canopen else None
            if evidence:
                device = FoundDevice(node.id)
                entries.append(ScanEntry(node.name, DUPLICATE, node.id, device, evidence))
            elif self._sends(node):
                detail = "it sends; its identity was not read" if node.sdo else "it sends"
                entries.append(ScanEntry(node.name, OK, node.id, FoundDevice(node.id), detail))
            else:
                detail = "no frame received; the node may be there without sending"
                entries.append(ScanEntry(node.name, MISSING, node.id, None, detail))
        return entries + self._unknown_heartbeats()

    def active_entries(self) -> list[ScanEntry]:
        """Returns the verdict on each node after an active scan.

        The scan entries of the nodes come first, in the order of the robot file.  The scan entries
        of devices that are not in the robot file come last.
        """
        devices = self._assign_devices()
        entries = [self._verdict(node, devices.get(node.name)) for node in self.configuration.nodes]
        for device in (*self.findings.by_id.values(), *self.findings.without_id):
            if not self._is_listed(device, entries, devices.values()):
                entries.append(self._unknown_device(device))
        return entries + self._unknown_heartbeats()

    def _is_listed(
        self,
        device: FoundDevice,
        entries: Sequence[ScanEntry],
        assigned: Collection[FoundDevice],
    ) -> bool:
        """Returns ``True`` if the scan entries already contain the device."""
        if any(device is other for other in assigned):
            return True
        # If several devices have the same node id, one scan entry reports all of these devices.
        is_duplicate = device.id in self.findings.evidence and device.id != UNCONFIGURED
        if is_duplicate and any(entry.device_id == device.id for entry in entries):
            return True
        # LSS and SDO can find the same device, so devices are compared by identity and node id.
        return device.identity is not None and any(
            other.identity == device.identity and other.id == device.id for other in assigned
        )

    def _unknown_device(self, device: FoundDevice) -> ScanEntry:
        evidence = None if device.id is None else self.findings.evidence.get(device.id)
        if evidence is not None:
            return ScanEntry("", DUPLICATE, None, device, evidence)
        id_text = "no id" if device.id == UNCONFIGURED else f"id {device.id}"
        detail = f"a device with {id_text} that the robot file does not name"
        if device.identity is None:
            detail = f"the device with {id_text} does not report its identity"
        return ScanEntry("", UNEXPECTED, None, device, detail)

    # -- which device is which node ---------------------------------------------------------------

    def _assign_devices(self) -> dict[str, FoundDevice]:
        """Returns the scanned device for each node, by name of the node."""
        devices: dict[str, FoundDevice] = {}
        for node in self.configuration.nodes:
            device = self._device_of(node)
            if device is not None:
                devices[node.name] = device
        for node in self.configuration.nodes:
            # A node without serial number in the robot file is assigned to a matching device, if
            # exactly one device matches and this device matches no other node.
            if node.name in devices or not node.lss or node.serial is not None:
                continue
            free = [
                device
                for device in (*self.findings.without_id, *self.findings.by_id.values())
                if _can_be(node, device)
                and not any(device is assigned for assigned in devices.values())
            ]
            if len(free) != 1:
                continue
            rivals = [
                other
                for other in self.configuration.nodes
                if other.name not in devices
                and other.lss
                and other.serial is None
                and _can_be(other, free[0])
            ]
            if len(rivals) == 1:
                devices[node.name] = free[0]
        return devices

    def _device_of(self, node: NodeConfiguration) -> FoundDevice | None:
        """Returns the scanned device that is assigned to a node, or ``None`` if the node was not
        found.

        The scanned device of a node is found by the serial number, by the node id, or by the
        periodic CAN frames.
        """
        by_id = self.findings.by_id
        selected = self.findings.by_name.get(node.name)
        at_id = by_id.get(node.id) if node.canopen else None
        if selected is not None:
            answering = None if selected.id is None else by_id.get(selected.id)
            same = answering is not None and answering.identity == selected.identity
            return answering if same else selected
        if at_id is not None and _can_be(node, at_id):
            return at_id
        if node.serial is not None:
            # A device may report its serial number over SDO without responding to LSS.
            elsewhere = next((device for device in by_id.values() if _can_be(node, device)), None)
            if elsewhere is not None:
                return elsewhere
        if not node.sdo and self._sends(node):
            return FoundDevice(node.id if node.canopen else None)
        return None

    # -- verdicts ---------------------------------------------------------------------------------

    def _verdict(self, node: NodeConfiguration, device: FoundDevice | None) -> ScanEntry:
        evidence = self.findings.evidence
        node_id = node.id if node.canopen else None
        if device is not None and device.id in evidence and device.id is not None:
            return ScanEntry(node.name, DUPLICATE, node_id, device, evidence[device.id])
        if node_id in evidence and node_id is not None:
            return ScanEntry(node.name, DUPLICATE, node_id, device, evidence[node_id])
        if device is not None and not device.has_type_of(node):
            actual = "none" if device.device_type is None else f"{device.device_type:#x}"
            detail = f"its device type is {actual}, not {node.device_type:#x}"
            return ScanEntry(node.name, WRONG_IDENTITY, node_id, device, detail)
        if device is not None and device.id == node_id:
            return ScanEntry(node.name, OK, node_id, device)
        other = self.findings.by_id.get(node.id) if node.canopen and node.sdo else None
        if other is not None:
            detail = f"the device at id {node.id} is {identity_text(other.identity)}"
            if device is not None:
                detail += f", and {node.name} has {device.id_text}"
            return ScanEntry(node.name, WRONG_IDENTITY, node_id, device, detail)
        if device is not None:
            without = device.id == UNCONFIGURED
            detail = "it has no id yet" if without else f"it has the id {device.id}"
            return ScanEntry(node.name, WITHOUT_ID, node_id, device, detail)
        return ScanEntry(node.name, MISSING, node_id, None, "no device answers for it")

    def _sends(self, node: NodeConfiguration) -> bool:
        return any(identifier in self._received for identifier, _ in node.seen_by)

    def _unknown_heartbeats(self) -> list[ScanEntry]:
        """Returns scan entries for unknown node ids from which only heartbeats were received."""
        entries = []
        for identifier in sorted(self._received):
            node = identifier - HEARTBEAT
            if identifier in self._known or not 0 < node < HIGHEST_NODE_ID:
                continue
            selected = self.findings.by_name.values()
            if node not in self.findings.by_id and all(device.id != node for device in selected):
                detail = f"a node with the id {node} sends heartbeats; it is not in the robot file"
                entries.append(ScanEntry("", UNEXPECTED, None, FoundDevice(node), detail))
        return entries


def _can_be(node: NodeConfiguration, device: FoundDevice) -> bool:
    """Returns ``True`` if the identity and the type of a device match the node in the robot
    file."""
    if device.identity is None or not node.is_like(device.identity):
        return False
    required = node.device_type
    return required is None or device.device_type is None or required == device.device_type
