"""Reads files of others that describe CAN devices, in limited worker processes.

``eds_worker`` reads an EDS or DCF file of CANopen (CiA 306), whose object dictionary is a
``Dictionary``.  A tool can read other formats with ``read_contained``.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.sandbox.worker_process import WorkerLimitError, WorkerLimits, limited_worker
from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model.bus import OBJECT_TYPES, DescribedObject

MAX_BYTES = 4_000_000
MAX_REMEMBERED = 16
"""Number of files whose content is kept, so that equal devices and repeated checks read it once."""
_LIMITS = WorkerLimits(wall_seconds=60.0, processor_seconds=40, memory_bytes=1 << 30)
_TYPES = {number: name for name, (number, _) in OBJECT_TYPES.items()}


def read_contained(
    data: bytes,
    display: str,
    format_name: str,
    service: str,
    report: Report,
    node: str = "",
    imports: Sequence[str] = (),
) -> dict[str, Any] | None:
    """Returns what a limited worker process reads in a file of others.

    Returns ``None`` and reports an error at its line if the content is not of the format.

    - ``data``: content of the file, at most ``MAX_BYTES``.
    - ``display``: name of the file in messages.
    - ``service``: name of the module that answers the request.
    - ``node``: name of the node whose content is read.
    - ``imports``: modules that the worker imports before its limits are in force.
    """
    try:
        answer = _answer(service, data, node, tuple(imports))
    except WorkerLimitError as error:
        answer = {"error": f"its reader {error}"}
    if "error" not in answer:
        return answer
    line, column = answer.get("line", 1), answer.get("column", 1)
    text = f"`{display}` cannot be read as a file of the format {format_name}: {answer['error']}"
    report.add("file-unreadable", text, Span(display, line, column, line, column + 1))
    return None


@functools.lru_cache(maxsize=MAX_REMEMBERED)
def _answer(service: str, data: bytes, node: str, imports: tuple[str, ...]) -> dict[str, Any]:
    """Returns the answer of a worker.  Raises ``WorkerLimitError``."""
    folders = [os.path.abspath(folder) for folder in sys.path] if imports else []
    with limited_worker(service, _LIMITS, path=folders, imports=imports) as worker:
        return worker.ask({"node": node}, data)[0]


# -- EDS and DCF files of CANopen ----------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """An entry of the object dictionary, as ``eds_worker`` describes it."""

    index: int
    subindex: int
    fields: dict[str, Any]

    @property
    def shown(self) -> str:
        return f"0x{self.index:04X}:{self.subindex}"

    @property
    def type(self) -> str | None:
        """Name of the type in a module, or ``None`` if a module has no such type."""
        return _TYPES.get(self.fields["type"])

    @property
    def is_writable(self) -> bool:
        return self.fields["access"] in ("rw", "rwr", "rww", "wo")

    def number(self, key: str, node_id: int) -> int | None:
        """Returns the ``value`` or the limit ``low`` or ``high`` of a device, if the file has it.

        Files state negative numbers of signed types with a sign or in two's complement.
        """
        stated = self.fields[key]
        if stated is None:
            return None
        number: int = stated[0] + stated[1] * node_id
        if self.type is None:
            return number
        bits = OBJECT_TYPES[self.type][1]
        if self.type.startswith("integer"):
            return number - (1 << bits) if 1 << bits - 1 <= number < 1 << bits else number
        return number + (1 << bits) if -(1 << bits - 1) <= number < 0 else number

    def limits(self, node_id: int) -> tuple[int | None, int | None]:
        """Returns the least and the greatest value, each ``None`` if the file does not limit it.

        Some files state the limits 0 and 0, or exchanged limits, instead of none.
        """
        low, high = self.number("low", node_id), self.number("high", node_id)
        if low is not None and high is not None and (low > high or low == high == 0):
            return None, None
        return low, high

    @property
    def described(self) -> DescribedObject:
        low, high = (self.fields[key] for key in ("low", "high"))
        depends = any(limit is not None and limit[1] for limit in (low, high))
        value, adds_node_id = self.number("value", 0), bool((self.fields["value"] or (0, 0))[1])
        limits = (None, None) if depends else self.limits(0)
        access = self.fields["access"]
        return DescribedObject(
            self.index, self.subindex, self.type or "", access, value, adds_node_id, *limits
        )


class Dictionary:
    """The object dictionary of a file.

    ``data``: bytes of the file; ``file``: its name in messages.
    """

    def __init__(self, content: dict[str, Any], data: bytes, file: str) -> None:
        self.data = data
        self.info: dict[str, str] = content["info"]
        self.node_id: int | None = content["node_id"]
        self.file = file
        self._entries = {
            key: Entry(*key, fields)
            for name, fields in content["objects"].items()
            for key in [(int(name.partition(":")[0]), int(name.partition(":")[2]))]
        }
        self.indices = frozenset(index for index, _ in self._entries)

    def get(self, index: int, subindex: int = 0) -> Entry | None:
        return self._entries.get((index, subindex))

    def number(self, index: int, subindex: int = 0) -> int | None:
        """Returns the value of an entry that does not depend on the node id, or ``None``."""
        entry = self.get(index, subindex)
        value = entry.fields["value"] if entry is not None else None
        return None if value is None or value[1] else int(value[0])

    def span(self, index: int, subindex: int = 0) -> Span:
        entry = self.get(index, subindex)
        line = entry.fields["line"] if entry is not None else 1
        return Span(self.file, line, 1, line, 2)

    @property
    def described(self) -> tuple[DescribedObject, ...]:
        """All entries, sorted by index and subindex."""
        return tuple(self._entries[key].described for key in sorted(self._entries))

    @property
    def profile(self) -> int:
        """Number of the device profile, such as 402, or 0."""
        return (self.number(0x1000) or 0) & 0xFFFF


def read_eds(path: Path, display: str, report: Report) -> Dictionary | None:
    """Returns the object dictionary of an EDS or DCF file, or ``None`` if it has errors.

    ``display``: name of the file in messages.
    """
    data = read_bytes(path, display, report, limit=MAX_BYTES)
    if data is None:
        return None
    content = read_contained(data, display, "EDS", f"{__package__}.eds_worker", report)
    return None if content is None else Dictionary(content, data, display)
