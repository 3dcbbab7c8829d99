"""The result of a scan: the devices on the bus, and the verdict on each node."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity

OK, MISSING, UNEXPECTED = "ok", "missing", "unexpected"
DUPLICATE, WRONG_IDENTITY, WITHOUT_ID = "duplicate-suspected", "wrong-identity", "unconfigured"


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device on the bus.  ``id`` 255: it has no id; ``None``: it is not a CANopen device."""

    id: int | None
    identity: Identity | None = None
    device_type: int | None = None
    texts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ScanEntry:
    """The verdict on a node, or on a device that the robot file does not name (``node`` empty)."""

    node: str
    verdict: str
    wanted_id: int | None
    device: FoundDevice | None
    detail: str = ""


@dataclass(frozen=True, slots=True)
class ScanResult:
    """``active``: the scan sent requests.  ``masters``: frames of another master.

    ``enabled``: drives that may move, each with the reason.  ``duplicates``: evidence by id.
    ``values``: contents of the object dictionaries by node, where they were read; ``None``: the
    node refuses to read an object.
    """

    active: bool
    entries: tuple[ScanEntry, ...]
    masters: tuple[str, ...] = ()
    enabled: tuple[tuple[str, str], ...] = ()
    duplicates: tuple[tuple[int, str], ...] = ()
    values: dict[str, dict[tuple[int, int], int | None]] = field(default_factory=dict)
    frames: int = 0

    def entry(self, node: str) -> ScanEntry:
        """Raises ``KeyError``."""
        for entry in self.entries:
            if entry.node == node:
                return entry
        raise KeyError(node)

    def ids(self) -> dict[str, int]:
        """The CANopen id of each node of the robot on the bus; 255: it has none."""
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
    """``vendor 0x469, product 0x402, revision 0x1, serial 0x101``"""
    if identity is None:
        return "a device of unknown identity"
    vendor, product, revision, serial = identity
    text = f"vendor {vendor:#x}, product {product:#x}, revision {revision:#x}"
    return f"{text}, serial {serial:#x}" if serial else text
