"""Whether a node's object dictionary has the values of the robot's file: read, never written."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from thorvaldc.model.bus import OBJECT_TYPES, ObjectValue
from thorvaldc.runtime.can_base.motor_controller import Message

ANSWER_TIME = 0.1
"""s"""
TRIES = 3
_UPLOAD, _ABORT = 0x40, 0x80


class ObjectCheck:
    """Reads a node's entries one after another by SDO (CiA 301, expedited).

    ``problem``: empty while nothing is wrong.
    """

    def __init__(self, request: int, response: int, entries: Iterable[ObjectValue]) -> None:
        """``request`` and ``response`` are the COB-IDs of the node's SDO."""
        self.request = request
        self.response = response
        self.problem = ""
        self._left = list(entries)[::-1]
        self._asked_at: float | None = None
        self._tries = 0

    @property
    def done(self) -> bool:
        return not self._left or bool(self.problem)

    def ask(self, now: float) -> Message | None:
        """The next request, where one is due; the same again after a time without answer."""
        if self.done or (self._asked_at is not None and now - self._asked_at < ANSWER_TIME):
            return None
        entry = self._left[-1]
        if self._tries >= TRIES:
            self.problem = f"does not answer when asked for {_shown(entry)}"
            return None
        self._tries += 1
        self._asked_at = now
        data = struct.pack("<BHB4x", _UPLOAD, entry.index, entry.subindex)
        return Message(self.request, data)

    def take(self, data: bytes) -> None:
        """An answer of the node."""
        if self.done or self._asked_at is None or len(data) < 8:
            return
        entry = self._left[-1]
        if struct.unpack_from("<HB", data, 1) != (entry.index, entry.subindex):
            return
        if data[0] == _ABORT:
            code = struct.unpack_from("<I", data, 4)[0]
            self.problem = f"does not tell {_shown(entry)} (SDO abort {code:#010x})"
            return
        size = OBJECT_TYPES[entry.type][1] + 7 >> 3
        signed = entry.type.startswith("integer")
        value = int.from_bytes(data[4 : 4 + size], "little", signed=signed)
        if value != entry.value:
            self.problem = f"{_shown(entry)} is {value}, the robot's file says {entry.value}"
            return
        self._left.pop()
        self._asked_at, self._tries = None, 0


def _shown(entry: ObjectValue) -> str:
    return f"{entry.name} ({entry.index:#06x}:{entry.subindex})"
