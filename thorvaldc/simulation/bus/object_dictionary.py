"""The object dictionary of a simulated CANopen device (CiA 301)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

from thorvaldc.can.sdo import AbortCode
from thorvaldc.model.bus import DescribedObject

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


DelayedWrite = Callable[[Callable[[], None]], None]
"""A write that takes time.  The argument is a function that is called at the end of the write."""


class SdoAbort(Exception):
    """The server aborts an SDO transfer with an abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"abort {code:#010x}")
        self.code = code


@dataclass(slots=True, eq=False)
class Entry:
    """One entry of a CANopen object dictionary.

    * ``kind``: data type, ``u8`` to ``i32``, ``bool``, ``f32`` or ``text``.
    * ``access``: access by a client, ``ro``, ``rw``, ``wo`` or ``const``.
    * ``read``: function that computes the current value, for example of a measurement.
    * ``write``: function that is called before a new value is set.  The function may raise
      ``SdoAbort`` to refuse the value of the entry.  The function may return a ``DelayedWrite`` for
      a write that takes time.  The SDO server responds after the end of the write.
    * ``lower``, ``upper``: limits of the accepted values.
    * ``stored``: true if object 0x1010 stores the value of the entry in non-volatile memory.
    """

    kind: str
    value: Any = 0
    access: str = "ro"
    _: KW_ONLY
    read: Callable[[], Any] | None = None
    write: Callable[[Any], DelayedWrite | None] | None = None
    lower: float | None = None
    upper: float | None = None
    stored: bool = False

    @property
    def size(self) -> int:
        """Length of the value of the object dictionary entry in bytes, or 0 for a text."""
        number_format = _FORMATS.get(self.kind)
        return struct.calcsize(number_format) if number_format else 0

    def get(self) -> Any:
        return self.value if self.read is None else self.read()

    def set(self, value: Any) -> DelayedWrite | None:
        """Sets the object dictionary entry to a value that an SDO client writes.

        Raises ``SdoAbort`` if the object dictionary entry does not accept the value.
        """
        if not self._is_within_limits(value):
            raise SdoAbort(AbortCode.VALUE_RANGE)
        delayed = self.write(value) if self.write is not None else None
        self.value = value
        return delayed

    def can_have(self, value: Any) -> bool:
        """Returns whether a value fits into the data type and is within the limits."""
        if self.kind != "text":
            try:
                struct.pack(_FORMATS[self.kind], value)
            except (struct.error, OverflowError):
                return False
        return self._is_within_limits(value)

    def _is_within_limits(self, value: Any) -> bool:
        too_low = self.lower is not None and value < self.lower
        return not (too_low or (self.upper is not None and value > self.upper))

    def encode(self) -> bytes:
        """Encodes the value of the object dictionary entry as bytes for an SDO or a PDO."""
        value = self.get()
        if self.kind == "text":
            return str(value).encode("latin-1", "replace")
        if self.kind not in ("bool", "f32"):
            bits = 8 * self.size
            value = int(value) & (1 << bits) - 1
            return value.to_bytes(self.size, "little")
        return struct.pack(_FORMATS[self.kind], value)

    def decode(self, data: bytes) -> Any:
        """Decodes the value of an object dictionary entry from received bytes.

        A number must have the right number of bytes.
        """
        if self.kind == "text":
            return data.decode("latin-1")
        return struct.unpack(_FORMATS[self.kind], data)[0]


class ObjectDictionary:
    """The entries of a CANopen object dictionary, by index and subindex.

    ``length_aborts``: true if the abort code tells whether a value is too long or too short.
    """

    def __init__(self, *, length_aborts: bool = False) -> None:
        self.length_aborts = length_aborts
        self._entries: dict[tuple[int, int], Entry] = {}
        self._indices: dict[int, None] = {}

    def add(self, index: int, subindex: int, entry: Entry) -> Entry:
        self._entries[index, subindex] = entry
        self._indices[index] = None
        return entry

    def add_record(self, index: int, *entries: Entry) -> None:
        """Adds a record (an object with several entries) to the object dictionary.

        The entries of the record have the subindices from 1 on.  The entry at subindex 0 of a
        record contains the highest subindex.
        """
        self.add(index, 0, Entry("u8", len(entries), "const"))
        for subindex, entry in enumerate(entries, 1):
            self.add(index, subindex, entry)

    def remove(self, index: int, subindex: int) -> None:
        del self._entries[index, subindex]

    def __getitem__(self, key: tuple[int, int]) -> Entry:
        """Returns the object dictionary entry with the given index and subindex.

        Raises ``SdoAbort`` if the object dictionary does not contain the entry.
        """
        try:
            return self._entries[key]
        except KeyError:
            known = key[0] in self._indices
            code = AbortCode.SUBINDEX_UNKNOWN if known else AbortCode.OBJECT_UNKNOWN
            raise SdoAbort(code) from None

    def __contains__(self, key: tuple[int, int]) -> bool:
        return key in self._entries

    def upload(self, index: int, subindex: int) -> bytes:
        """Returns the bytes of an object dictionary entry that an SDO client reads.

        Raises ``SdoAbort`` if the object dictionary entry does not exist or is not readable.
        """
        entry = self[index, subindex]
        if entry.access == "wo":
            raise SdoAbort(AbortCode.WRITE_ONLY)
        return entry.encode()

    def download(self, index: int, subindex: int, data: bytes) -> DelayedWrite | None:
        """Sets an object dictionary entry to the value in the bytes that an SDO client writes.

        Raises ``SdoAbort`` if the object dictionary entry does not accept the value.
        """
        entry = self[index, subindex]
        if entry.access in ("ro", "const"):
            raise SdoAbort(AbortCode.READ_ONLY)
        self.check_length(entry, len(data))
        return entry.set(entry.decode(data))

    def check_length(self, entry: Entry, length: int) -> None:
        """Raises ``SdoAbort`` if the value of the entry cannot have ``length`` bytes."""
        if entry.size in (0, length):
            return
        if not self.length_aborts:
            raise SdoAbort(AbortCode.LENGTH_WRONG)
        raise SdoAbort(AbortCode.TOO_LONG if length > entry.size else AbortCode.TOO_SHORT)

    def parameters(self) -> dict[str, Any]:
        """Returns the values of the object dictionary entries in non-volatile memory.

        The key of each value is ``index.subindex`` in hexadecimal.
        """
        return {name: entry.value for name, entry in self._stored()}

    def restore(self, values: dict[str, Any]) -> None:
        """Sets the object dictionary entries to the values that ``parameters`` returned.

        Values that an entry cannot have are ignored: a device uses its default instead of a damaged
        value.
        """
        for name, entry in self._stored():
            if name in values and entry.can_have(values[name]):
                entry.value = values[name]

    def _stored(self) -> Iterator[tuple[str, Entry]]:
        for (index, subindex), entry in self._entries.items():
            if entry.stored:
                yield parameter_name(index, subindex), entry


_KINDS = {
    "boolean": "bool",
    **{f"integer{bits}": f"i{bits}" for bits in (8, 16, 32)},
    **{f"unsigned{bits}": f"u{bits}" for bits in (8, 16, 32)},
}
_OF_COMMUNICATION = range(0x1000, 0x2000)
_IDENTITY = 0x1018


def described_objects(
    objects: ObjectDictionary, described: Sequence[DescribedObject], node_id: int
) -> ObjectDictionary:
    """Returns the entries that an SDO client of a device can access, as its EDS describes them.

    Entries that only the EDS has are added to ``objects``, with their default values.  The others
    get type, access, limits, and in the communication profile the default value of the EDS; they
    keep the behaviour of the simulated device.  Texts, and numbers of types that a module does not
    have, are empty texts.
    """
    served = ObjectDictionary(length_aborts=objects.length_aborts)
    for each in described:
        key = (each.index, each.subindex)
        is_new = key not in objects
        is_number = bool(each.type) and (is_new or objects[key].kind != "text")
        entry = objects.add(*key, Entry("text", "", "rw")) if is_new else objects[key]
        served.add(*key, entry)
        if each.access and entry.read is None:
            entry.access = each.access if each.access in ("ro", "wo", "const") else "rw"
        if not is_number:
            continue
        entry.kind = _KINDS[each.type]
        entry.lower = each.lower if entry.lower is None else entry.lower
        entry.upper = each.upper if entry.upper is None else entry.upper
        if is_new:
            entry.value, entry.stored = 0, entry.access == "rw"
        has_default = is_new or (each.index in _OF_COMMUNICATION and each.index != _IDENTITY)
        if has_default and each.value is not None:
            entry.value = each.value + (node_id if each.adds_node_id else 0)
    return served


def parameter_name(index: int, subindex: int) -> str:
    """Returns the name of a stored object dictionary entry, such as ``1017.00``."""
    return f"{index:04x}.{subindex:02x}"
