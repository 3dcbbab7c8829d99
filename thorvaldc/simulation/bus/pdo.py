"""Process data objects of a CANopen device: communication, mapping, SYNC and events (CiA 301)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.simulation.bus.object_dictionary import (
    MAPPING_TOO_LONG,
    NOT_MAPPABLE,
    STATE_REFUSED,
    Entry,
    Later,
    ObjectDictionary,
    SdoAbort,
)

INVALID = 1 << 31
SYNCHRONOUS = 240
"""The highest transmission type that waits for SYNC."""
EVENT_DRIVEN = 255
_MAPPED = 8


class Pdo(NamedTuple):
    """A PDO as it is before anything is configured.

    ``number`` from 1; ``cob_id``; ``transmission`` type; ``mapping``: index, subindex and
    bits of each object in it; ``event_ms`` of one that is sent by time.
    """

    number: int
    cob_id: int
    transmission: int
    mapping: tuple[tuple[int, int, int], ...]
    event_ms: int = 0


class _Configured:
    """The entries of one PDO in the object dictionary."""

    def __init__(self, pdo: Pdo, sends: bool, objects: ObjectDictionary) -> None:
        self.sends = sends
        self._objects = objects
        self.pending: bytes | None = None
        self.syncs = 0
        self.last: bytes | None = None
        base = 0x1800 if sends else 0x1400
        index = base + pdo.number - 1
        self.cob = Entry("u32", pdo.cob_id, "rw", write=self._check_cob, stored=True)
        self.type = Entry("u8", pdo.transmission, "rw", stored=True)
        self.event = Entry("u16", pdo.event_ms, "rw", stored=True)
        objects.add(index, 0, Entry("u8", 5, "const"))
        objects.add(index, 1, self.cob)
        objects.add(index, 2, self.type)
        objects.add(index, 3, Entry("u16", 0, "rw", stored=True))
        objects.add(index, 5, self.event)
        words = [place << 16 | sub << 8 | bits for place, sub, bits in pdo.mapping]
        self.count = Entry(
            "u8", len(words), "rw", upper=_MAPPED, write=self._check_count, stored=True
        )
        objects.add(index + 0x200, 0, self.count)
        self.slots = []
        for slot in range(_MAPPED):
            value = words[slot] if slot < len(words) else 0
            entry = Entry("u32", value, "rw", write=self._check_slot, stored=True)
            self.slots.append(objects.add(index + 0x200, slot + 1, entry))

    @property
    def cob_id(self) -> int | None:
        """``None`` where it is switched off."""
        value: int = self.cob.value
        return None if value & INVALID else value & 0x7FF

    def mapped(self) -> list[Entry | int]:
        """The entries in order; a number of bits where nothing is."""
        found: list[Entry | int] = []
        for slot in self.slots[: self.count.value]:
            place = (slot.value >> 16, slot.value >> 8 & 0xFF)
            found.append(self._objects[place] if place in self._objects else slot.value & 0xFF)
        return found

    def pack(self) -> bytes:
        parts = [
            item.encode() if isinstance(item, Entry) else bytes(item // 8) for item in self.mapped()
        ]
        return b"".join(parts)

    def unpack(self, data: bytes) -> None:
        at = 0
        for item in self.mapped():
            size = item.size if isinstance(item, Entry) else item // 8
            if isinstance(item, Entry):
                with contextlib.suppress(SdoAbort):  # a value out of range is left alone
                    item.set(item.decode(data[at : at + size]))
            at += size

    @property
    def length(self) -> int:
        sizes = [item.size if isinstance(item, Entry) else item // 8 for item in self.mapped()]
        return sum(sizes)

    def _check_cob(self, value: Any) -> Later | None:
        """The identifier changes only while the PDO is switched off."""
        changed = (value ^ self.cob.value) & 0x7FF
        if changed and not (value & INVALID or self.cob.value & INVALID):
            raise SdoAbort(STATE_REFUSED)
        return None

    def _check_slot(self, value: Any) -> Later | None:
        if self.count.value or not self.cob.value & INVALID:
            raise SdoAbort(STATE_REFUSED)
        place = (value >> 16, value >> 8 & 0xFF)
        if value and (place not in self._objects or self._objects[place].size == 0):
            raise SdoAbort(NOT_MAPPABLE)
        return None

    def _check_count(self, value: Any) -> Later | None:
        if not self.cob.value & INVALID:
            raise SdoAbort(STATE_REFUSED)
        bits = sum(slot.value & 0xFF for slot in self.slots[:value])
        if bits > 64:
            raise SdoAbort(MAPPING_TOO_LONG)
        return None


class PdoSet:
    """The PDOs of a device.  ``send`` sends a frame; ``after`` plans something in s."""

    def __init__(
        self,
        objects: ObjectDictionary,
        received: Sequence[Pdo],
        sent: Sequence[Pdo],
        send: Callable[[int, bytes], None],
    ) -> None:
        self._send = send
        self.received = [_Configured(pdo, False, objects) for pdo in received]
        self.sent = [_Configured(pdo, True, objects) for pdo in sent]
        self._next_event = [0.0] * len(self.sent)

    def receive(self, frame: CanFrame) -> bool:
        """Take the values of a frame, at once or at the next SYNC; whether it is one of these."""
        for pdo in self.received:
            if pdo.cob_id == frame.id:
                if len(frame.data) < pdo.length:
                    continue  # CiA 301: too short, not taken
                if pdo.type.value <= SYNCHRONOUS:
                    pdo.pending = frame.data
                else:
                    pdo.unpack(frame.data)
                return True
        return False

    def cob_ids(self) -> list[int]:
        return [pdo.cob_id for pdo in self.received if pdo.cob_id is not None]

    def synchronise(self) -> None:
        """SYNC: what was received becomes valid, what is synchronous is sampled and sent."""
        for pdo in self.received:
            if pdo.pending is not None:
                data, pdo.pending = pdo.pending, None
                pdo.unpack(data)
        for pdo in self.sent:
            cob_id = pdo.cob_id
            if cob_id is None or not pdo.type.value <= SYNCHRONOUS:
                continue
            data = pdo.pack()
            pdo.syncs += 1
            every = pdo.type.value
            due = pdo.syncs >= every if every else data != pdo.last
            if due:
                pdo.syncs = 0
                pdo.last = data
                self._send(cob_id, data)

    def event_period(self, place: int) -> float:
        """s between two of a sent PDO, from 0 on; 0 where it has none or is switched off."""
        pdo = self.sent[place]
        period: int = pdo.event.value
        return period / 1000.0 if pdo.cob_id is not None else 0.0

    def set_event_period(self, place: int, milliseconds: int) -> None:
        self.sent[place].event.value = milliseconds

    def send_now(self, place: int) -> None:
        pdo = self.sent[place]
        if pdo.cob_id is not None:
            self._send(pdo.cob_id, pdo.pack())

    def tick(self, now: float) -> None:
        """Send what goes by time or, without one, by change."""
        for place, pdo in enumerate(self.sent):
            cob_id = pdo.cob_id
            if cob_id is None or pdo.type.value <= SYNCHRONOUS:
                continue
            period = pdo.event.value / 1000.0
            if period and now + 1e-9 < self._next_event[place]:
                continue
            data = pdo.pack()
            if not period and data == pdo.last:
                continue
            pdo.last = data
            late = now - self._next_event[place]
            self._next_event[place] = (now if late > period else self._next_event[place]) + period
            self._send(cob_id, data)
