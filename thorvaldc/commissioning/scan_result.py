"""Result of a scan: the devices on the bus and the verdict on each node."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity

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
            entry.node: entry.device.id
            for entry in self.entries
            if entry.node and entry.device is not None and entry.device.id is not None
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
    text = f"vendor {vendor:#x}, product {product:#x}, revision {revision:#x}"
    return f"{text}, serial {serial:#x}" if serial else text
