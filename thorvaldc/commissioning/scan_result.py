"""What a scan has found, and the verdict on each node."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can.lss import UNCONFIGURED, Identity

OK, MISSING, UNEXPECTED = "ok", "missing", "unexpected"
DUPLICATE, WRONG_IDENTITY, WITHOUT_ID = "duplicate-suspected", "wrong-identity", "unconfigured"


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device on the bus.  ``id`` 255: it has none; ``None``: it is not CANopen's."""

    id: int | None
    identity: Identity | None = None
    device_type: int | None = None
    texts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ScanEntry:
    """The verdict on a node, or on a device that is none of the robot's (``node`` empty)."""

    node: str
    verdict: str
    wanted_id: int | None
    found: FoundDevice | None
    detail: str = ""


@dataclass(frozen=True, slots=True)
class ScanResult:
    """``active``: nodes were asked, not only listened to.  ``masters``: signs of another master.

    ``enabled``: drives that may move.  ``values``: by node what its objects hold (``None``:
    it cannot be read), where they were read.  ``duplicates``: evidence by id.
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
        """The CANopen id of each of the robot's nodes that was found; 255: it has none."""
        return {
            e.node: e.found.id
            for e in self.entries
            if e.node and e.found is not None and e.found.id is not None
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
    found = entry.found
    return {
        "node": entry.node or None,
        "verdict": entry.verdict,
        "wanted_id": entry.wanted_id,
        "found_id": None if found is None or found.id == UNCONFIGURED else found.id,
        "identity": None if found is None or found.identity is None else list(found.identity),
        "device_type": None if found is None else found.device_type,
        "texts": [] if found is None else list(found.texts),
        "detail": entry.detail,
    }


def identity_text(identity: Identity | None) -> str:
    """``vendor 0x00000469, product 402, serial 0x101``"""
    if identity is None:
        return "a device of unknown identity"
    vendor, product, revision, serial = identity
    text = f"vendor {vendor:#x}, product {product:#x}, revision {revision:#x}"
    return f"{text}, serial {serial:#x}" if serial else text
