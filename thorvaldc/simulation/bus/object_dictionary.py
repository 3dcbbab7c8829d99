"""A device's object dictionary (CiA 301): entries with a type, an access and a value."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

# Abort codes of SDO transfers, CiA 301.
TOGGLE_NOT_ALTERNATED = 0x05030000
TIMED_OUT = 0x05040000
COMMAND_UNKNOWN = 0x05040001
UNSUPPORTED_ACCESS = 0x06010000
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
OBJECT_UNKNOWN = 0x06020000
NOT_MAPPABLE = 0x06040041
MAPPING_TOO_LONG = 0x06040042
LENGTH_WRONG = 0x06070010
SUBINDEX_UNKNOWN = 0x06090011
VALUE_RANGE = 0x06090030
STORE_REFUSED = 0x08000020
STATE_REFUSED = 0x08000022

_FORMATS = {
    "bool": "<?",
    "i8": "<b",
    "i16": "<h",
    "i32": "<i",
    "u8": "<B",
    "u16": "<H",
    "u32": "<I",
    "f32": "<f",
}


Later = Callable[[Callable[[], None]], None]
"""What takes its time: called with what is to be done when it is finished."""


class SdoAbort(Exception):
    """A transfer is refused with this abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"abort {code:#010x}")
        self.code = code


class Entry:
    """One value.  ``kind`` is ``u8`` to ``i32``, ``bool``, ``f32`` or ``text``.

    ``access`` is ``ro``, ``rw``, ``wo`` or ``const``.  ``read`` gives a value that changes
    by itself.  ``write`` is called before a new value is taken; it may raise
    ``SdoAbort``, or return what is to be waited for before the answer.  ``lower`` and
    ``upper`` bound what is taken.  ``stored`` entries are among the parameters that a
    device stores (0x1010).
    """

    __slots__ = ("access", "kind", "lower", "read", "stored", "upper", "value", "write")

    def __init__(
        self,
        kind: str,
        value: Any = 0,
        access: str = "ro",
        *,
        read: Callable[[], Any] | None = None,
        write: Callable[[Any], Later | None] | None = None,
        lower: float | None = None,
        upper: float | None = None,
        stored: bool = False,
    ) -> None:
        self.kind = kind
        self.value = value
        self.access = access
        self.read = read
        self.write = write
        self.lower = lower
        self.upper = upper
        self.stored = stored

    @property
    def size(self) -> int:
        """Bytes; 0 for text, which has no fixed size."""
        found = _FORMATS.get(self.kind)
        return struct.calcsize(found) if found else 0

    def get(self) -> Any:
        return self.value if self.read is None else self.read()

    def set(self, value: Any) -> Later | None:
        """Take a value as a client writes it.  Raises ``SdoAbort``."""
        too_low = self.lower is not None and value < self.lower
        if too_low or (self.upper is not None and value > self.upper):
            raise SdoAbort(VALUE_RANGE)
        later = self.write(value) if self.write is not None else None
        self.value = value
        return later

    def encode(self) -> bytes:
        value = self.get()
        if self.kind == "text":
            return str(value).encode("latin-1", "replace")
        if self.kind not in ("bool", "f32"):
            bits = 8 * self.size
            value = int(value) & (1 << bits) - 1
            return value.to_bytes(self.size, "little")
        return struct.pack(_FORMATS[self.kind], value)

    def decode(self, data: bytes) -> Any:
        """Raises ``SdoAbort`` where the length does not fit."""
        if self.kind == "text":
            return data.decode("latin-1")
        if len(data) != self.size:
            raise SdoAbort(LENGTH_WRONG)
        return struct.unpack(_FORMATS[self.kind], data)[0]


class ObjectDictionary:
    """Entries by index and subindex."""

    def __init__(self) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._indices: dict[int, None] = {}

    def add(self, index: int, subindex: int, entry: Entry) -> Entry:
        self._entries[index, subindex] = entry
        self._indices[index] = None
        return entry

    def add_record(self, index: int, *entries: Entry) -> None:
        """Entries from subindex 1 on, and their number at 0."""
        self.add(index, 0, Entry("u8", len(entries), "const"))
        for subindex, entry in enumerate(entries, 1):
            self.add(index, subindex, entry)

    def __getitem__(self, place: tuple[int, int]) -> Entry:
        """Raises ``SdoAbort`` where there is no such entry."""
        try:
            return self._entries[place]
        except KeyError:
            known = place[0] in self._indices
            raise SdoAbort(SUBINDEX_UNKNOWN if known else OBJECT_UNKNOWN) from None

    def __contains__(self, place: tuple[int, int]) -> bool:
        return place in self._entries

    def upload(self, index: int, subindex: int) -> bytes:
        """What a client reads.  Raises ``SdoAbort``."""
        entry = self[index, subindex]
        if entry.access == "wo":
            raise SdoAbort(WRITE_ONLY)
        return entry.encode()

    def download(self, index: int, subindex: int, data: bytes) -> Later | None:
        """What a client writes.  Raises ``SdoAbort``."""
        entry = self[index, subindex]
        if entry.access in ("ro", "const"):
            raise SdoAbort(READ_ONLY)
        return entry.set(entry.decode(data))

    def parameters(self) -> dict[str, Any]:
        """The stored entries' values, by ``index.subindex`` in hexadecimal."""
        return {name: entry.value for name, entry in self._stored()}

    def restore(self, values: dict[str, Any]) -> None:
        for name, entry in self._stored():
            if name in values:
                entry.value = values[name]

    def _stored(self) -> Iterator[tuple[str, Entry]]:
        for (index, subindex), entry in self._entries.items():
            if entry.stored:
                yield f"{index:04x}.{subindex:02x}", entry
