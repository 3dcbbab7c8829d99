"""The PDOs of a simulated CANopen device (CiA 301)."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.sdo import AbortCode
from thorvaldc.model import FrameDefinition
from thorvaldc.model.bus import OBJECT_TYPES
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus.object_dictionary import (
    DelayedWrite,
    Entry,
    ObjectDictionary,
    SdoAbort,
)

# Objects of the object dictionary that configure PDO number n.  The base index is 0x1400 for an
# RPDO and 0x1800 for a TPDO:
#
#     base + n - 1           sub 1 COB-ID (bit 31: switched off), sub 2 transmission type,
#                            sub 3 inhibit time in 100 us, sub 5 event timer in ms
#     base + 0x200 + n - 1   sub 0 number of mapped entries, then index << 16 | subindex << 8 | bits
#
# Order in which a master must change the mapping of a PDO:
#
# 1. switch the PDO off,
# 2. set sub 0 of the mapping to 0,
# 3. write the mapping,
# 4. set sub 0 of the mapping to the number of mapped entries,
# 5. switch the PDO on.
#
# The device aborts the SDO transfers if the master changes the mapping in another order.
#
# The transmission type of a TPDO defines when the device sends the TPDO.  A TPDO with the
# transmission type 0 is sent at the next SYNC message if the data changed.  A TPDO with a
# transmission type n from 1 to 240 is sent at every n-th SYNC message.  A TPDO with a transmission
# type above 240 is sent after an event or when the event timer ends, but not earlier
# than the inhibit time after it was sent last.

INVALID = 1 << 31
SYNCHRONOUS = 240
"""Highest synchronous transmission type."""
EVENT_DRIVEN = 255
INHIBIT_UNIT = 100e-6
"""Unit (s) of the inhibit time of a TPDO."""
LONG_INHIBIT_TIME = 500
"""Inhibit time (in ``INHIBIT_UNIT``) with ``Quirk.INHIBIT_TIMES``."""
_SLOTS = 8
"""Largest number of mapped entries of a PDO."""


class Pdo(NamedTuple):
    """The factory configuration of a PDO.

    * ``number``: number of the PDO, from 1 on.
    * ``transmission``: transmission type.
    * ``mapping``: index, subindex and length (bits) of each mapped object.
    * ``event_ms``: event timer (ms), or 0 for a PDO without an event timer.
    """

    number: int
    cob_id: int
    transmission: int
    mapping: tuple[tuple[int, int, int], ...]
    event_ms: int = 0

    @classmethod
    def of_frame(cls, frame: FrameDefinition, node_id: int) -> Pdo:
        """Returns the event-driven PDO of a frame; ``cob_id`` is relative to the node id."""
        mapping = tuple((index, sub, OBJECT_TYPES[kind][1]) for index, sub, kind in frame.mapping)
        return cls(frame.pdo or 1, frame.cob_id - node_id, EVENT_DRIVEN, mapping)


class _ConfiguredPdo:
    """A PDO of a simulated device, with the configuration in the object dictionary."""

    def __init__(self, pdo: Pdo, transmit: bool, objects: ObjectDictionary) -> None:
        self._objects = objects
        self.pending: bytes | None = None
        """Received data that is applied at the next SYNC."""
        self.syncs = 0
        self.last: bytes | None = None
        """Data that the PDO sent last."""
        base = 0x1800 if transmit else 0x1400
        self.index = index = base + pdo.number - 1
        """Index of the communication parameters of the PDO in the object dictionary."""
        self.cob = Entry("u32", pdo.cob_id, "rw", write=self._check_cob, stored=True)
        self.type = Entry("u8", pdo.transmission, "rw", stored=True)
        self.event = Entry("u16", pdo.event_ms, "rw", stored=True)
        objects.add(index, 0, Entry("u8", 5, "const"))
        objects.add(index, 1, self.cob)
        objects.add(index, 2, self.type)
        self.inhibit = objects.add(index, 3, Entry("u16", 0, "rw", stored=True))
        objects.add(index, 5, self.event)
        mapping = [index << 16 | sub << 8 | bits for index, sub, bits in pdo.mapping]
        self.count = Entry(
            "u8", len(mapping), "rw", upper=_SLOTS, write=self._check_count, stored=True
        )
        objects.add(index + 0x200, 0, self.count)
        self.slots = []
        for slot in range(_SLOTS):
            value = mapping[slot] if slot < len(mapping) else 0
            entry = Entry("u32", value, "rw", write=self._check_slot, stored=True)
            self.slots.append(objects.add(index + 0x200, slot + 1, entry))

    @property
    def cob_id(self) -> int | None:
        """COB-ID of the PDO, or ``None`` if the PDO is switched off."""
        value: int = self.cob.value
        return None if value & INVALID else value & 0x7FF

    def mapped(self) -> list[Entry | int]:
        """Returns the object dictionary entries in the PDO, in the order of the data.

        An unused gap in the PDO data is returned as the number of bits of the gap.
        """
        items: list[Entry | int] = []
        for slot in self.slots[: self.count.value]:
            key = (slot.value >> 16, slot.value >> 8 & 0xFF)
            items.append(self._objects[key] if key in self._objects else slot.value & 0xFF)
        return items

    def pack(self) -> bytes:
        """Returns the values of the mapped object dictionary entries as CAN frame data."""
        parts = [
            item.encode() if isinstance(item, Entry) else bytes(item // 8) for item in self.mapped()
        ]
        return b"".join(parts)

    def unpack(self, data: bytes) -> None:
        """Sets the mapped object dictionary entries to the values in a received CAN frame.

        An object dictionary entry keeps the previous value if the received value is out of range.
        """
        position = 0
        for item in self.mapped():
            size = item.size if isinstance(item, Entry) else item // 8
            if isinstance(item, Entry):
                with contextlib.suppress(SdoAbort):
                    item.set(item.decode(data[position : position + size]))
            position += size

    @property
    def event_period(self) -> float:
        """Event timer (s), or 0 for a PDO without an event timer or that is switched off."""
        period: int = self.event.value
        return period / 1000.0 if self.cob_id is not None else 0.0

    @property
    def length(self) -> int:
        """Number of data bytes of the PDO."""
        sizes = [item.size if isinstance(item, Entry) else item // 8 for item in self.mapped()]
        return sum(sizes)

    def _check_cob(self, value: Any) -> DelayedWrite | None:
        """Checks that the COB-ID of a PDO changes only while the PDO is switched off."""
        changed = (value ^ self.cob.value) & 0x7FF
        if changed and not (value & INVALID or self.cob.value & INVALID):
            raise SdoAbort(AbortCode.STATE_REFUSED)
        return None

    def _check_slot(self, value: Any) -> DelayedWrite | None:
        if self.count.value or not self.cob.value & INVALID:
            raise SdoAbort(AbortCode.STATE_REFUSED)
        key = (value >> 16, value >> 8 & 0xFF)
        if value and (key not in self._objects or self._objects[key].size == 0):
            raise SdoAbort(AbortCode.NOT_MAPPABLE)
        return None

    def _check_count(self, value: Any) -> DelayedWrite | None:
        if not self.cob.value & INVALID:
            raise SdoAbort(AbortCode.STATE_REFUSED)
        bits = sum(slot.value & 0xFF for slot in self.slots[:value])
        if bits > 64:
            raise SdoAbort(AbortCode.MAPPING_TOO_LONG)
        return None


class PdoSet:
    """The PDOs of a simulated CANopen device.

    ``received`` has the RPDOs of the device, and ``sent`` has the TPDOs of the device.  If
    ``frozen`` is true, each TPDO repeats the data that was sent last, or first if there was none.
    """

    def __init__(
        self,
        objects: ObjectDictionary,
        received: Sequence[Pdo],
        sent: Sequence[Pdo],
        send: Callable[[int, bytes], None],
    ) -> None:
        """Adds the objects of all PDOs to the object dictionary.

        The function ``send`` sends a CAN frame and has the arguments identifier and data.
        """
        self._objects = objects
        self._transmit = send
        self.frozen = False
        self._newest: dict[int, bytes] = {}
        """Data that was sent last, by COB-ID."""
        self.received = [_ConfiguredPdo(pdo, False, objects) for pdo in received]
        self.sent = [_ConfiguredPdo(pdo, True, objects) for pdo in sent]
        self._next_event = [0.0] * len(self.sent)
        self._sent_at = [-math.inf] * len(self.sent)

    def _send(self, cob_id: int, data: bytes) -> None:
        if not self.frozen or cob_id not in self._newest:
            self._newest[cob_id] = data
        self._transmit(cob_id, self._newest[cob_id])

    def apply_quirks(self, quirks: frozenset[Quirk]) -> None:
        """Changes the factory settings of the PDOs as the quirks of the device say."""
        for pdo in self.sent:
            if Quirk.INHIBIT_TIMES in quirks:
                pdo.inhibit.value = LONG_INHIBIT_TIME
            if Quirk.NO_INHIBIT_TIMES in quirks:
                pdo.inhibit.value = 0
                self._objects.remove(pdo.index, 3)

    def receive(self, frame: CanFrame) -> bool:
        """Handles a received CAN frame.

        The received values of an RPDO apply immediately, or at the next SYNC message if the RPDO is
        synchronous.  Returns true if the CAN frame is an RPDO of the device.
        """
        for pdo in self.received:
            if pdo.cob_id == frame.id:
                if len(frame.data) < pdo.length:
                    continue  # CiA 301: a PDO that is too short is not processed
                if pdo.type.value <= SYNCHRONOUS:
                    pdo.pending = frame.data
                else:
                    pdo.unpack(frame.data)
                return True
        return False

    def cob_ids(self) -> list[int]:
        """Returns the COB-IDs of the RPDOs that are switched on."""
        return [pdo.cob_id for pdo in self.received if pdo.cob_id is not None]

    def synchronise(self) -> None:
        """Handles a received SYNC message.

        The function first applies the pending RPDOs, and then sends the synchronous TPDOs.
        """
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

    def send_now(self, index: int) -> None:
        """Sends the TPDO at the position ``index`` in ``sent``, unless it is switched off."""
        pdo = self.sent[index]
        if pdo.cob_id is not None:
            self._send(pdo.cob_id, pdo.pack())

    def tick(self, now: float) -> None:
        """Sends the event-driven TPDOs that are due at the time ``now`` (s).

        A TPDO with an event timer is due at the end of the event timer.  A TPDO without an event
        timer is due when the data of the TPDO changed.
        """
        for index, pdo in enumerate(self.sent):
            cob_id = pdo.cob_id
            if cob_id is None or pdo.type.value <= SYNCHRONOUS:
                continue
            period = pdo.event.value / 1000.0
            if period and now + 1e-9 < self._next_event[index]:
                continue
            if now + 1e-9 < self._sent_at[index] + pdo.inhibit.value * INHIBIT_UNIT:
                continue
            data = pdo.pack()
            if not period and data == pdo.last:
                continue
            pdo.last = data
            self._sent_at[index] = now
            late = now - self._next_event[index]
            self._next_event[index] = (now if late > period else self._next_event[index]) + period
            self._send(cob_id, data)
