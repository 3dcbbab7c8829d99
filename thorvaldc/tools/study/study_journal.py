"""The journal of a study: the result of each finished design, on the disk before the next."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics.atomic_file import append_whole
from thorvaldc.diagnostics.foreign_json import read_json

try:
    import fcntl
except ImportError:  # on Windows, two runs of one study are not kept apart
    fcntl = None  # type: ignore[assignment]

JOURNAL = "journal.jsonl"
_DIGITS = 16


class StudyBusyError(Exception):
    """Raised if another run writes the journal."""


class StudyJournal:
    """A file with one line per finished design: a checksum, and the result as JSON.

    A line is written by one system call.  A line that a killed process has left incomplete, or
    whose checksum is wrong, counts as not written.
    """

    def __init__(self, folder: Path) -> None:
        """Opens or creates the journal in a folder, and reads its results.

        Raises ``OSError`` if the file cannot be opened and ``StudyBusyError`` if another process
        has opened it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        self._file = os.open(folder / JOURNAL, flags, 0o644)
        try:
            if fcntl is not None:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise StudyBusyError(f"another run writes {folder / JOURNAL}") from None
        self.results = read_results(folder)
        size = os.fstat(self._file).st_size
        if size and os.pread(self._file, 1, size - 1) != b"\n":
            os.write(self._file, b"\n")  # ends the incomplete line of a killed process

    def append(self, key: str, result: dict[str, Any]) -> None:
        """Writes the result of a design, by the key of the design."""
        text = json.dumps({"key": key, **result}, ensure_ascii=False, separators=(",", ":"))
        data = text.encode()
        append_whole(self._file, _checksum(data) + b" " + data + b"\n")
        self.results[key] = result

    def close(self) -> None:
        os.close(self._file)


def read_results(folder: Path) -> dict[str, dict[str, Any]]:
    """Returns the results in the journal of a folder by the keys of the designs."""
    results: dict[str, dict[str, Any]] = {}
    with (folder / JOURNAL).open("rb") as file:
        for line in file:
            checksum, _, data = line.rstrip(b"\n").partition(b" ")
            if line.endswith(b"\n") and checksum == _checksum(data):
                result = read_json(data)
                results[result.pop("key")] = result
    return results


def _checksum(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest()[:_DIGITS].encode()
