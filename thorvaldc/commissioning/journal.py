"""Journal file of a flash, in which each line is a record in JSON.

A journal record is written to the disk before and after each step of a flash:

    {"record":"run", "mode":"apply", "hash":..., "plan":{...}, "chain":"9a03...64b9"}
    {"record":"begin", "step":0, "node":..., "what":..., "old":[previous values], "chain":...}
    {"record":"done", "step":0, "node":..., "read":what was read back, "chain":...}
    ...
    {"record":"end", "chain":...}   or {"record":"stopped", "reason":..., "chain":...}, or nothing
                                    after a power cut

``chain`` is the SHA-256, shortened, of the chain of the record before and of the line up to the
comma before ``chain``.  A journal in which a record was changed, deleted, doubled or moved is not
used, because its plan or its previous values may be wrong.  Only records that are missing at the
end cannot be noticed: the journal is then that of a power cut.

Records are appended to the journal and never changed.  A power cut can leave an incomplete line at
the end of the journal.  The reader skips an incomplete line at the end of the file or before a new
run.  An incomplete line of the journal can be skipped safely, because the configuration of the
devices is always read from the bus.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from thorvaldc.commissioning import bus_configuration
from thorvaldc.commissioning.plan import Plan, plan_from_json, plan_to_json
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.files import append_whole, check_regular, read_json
from thorvaldc.model.model_json import typed_value

FORMAT, VERSION = "thorvaldc-flash", 4
APPLY, RESUME, ROLLBACK = "apply", "resume", "rollback"
MAX_BYTES = 64_000_000
"""Limit of the size of a journal; a flash of a robot writes some 10 kB."""
_HEAD = b'{"record":"'
_LINE = re.compile(rb'(.*),"chain":"([0-9a-f]{32})"}')
"""A complete line: the record without its last brace, and its link of the chain."""


class Storage(Protocol):
    """Storage medium of a journal, for example a file."""

    name: str

    def read(self) -> bytes: ...

    def append(self, data: bytes) -> None:
        """Appends bytes to the journal file, and returns when the bytes are stored on the disk."""


class JournalFile:
    """Journal file, which is locked for this process while the file is open."""

    def __init__(self, path: Path) -> None:
        """Opens or creates the journal file ``path``.

        Raises ``OSError`` if the journal file cannot be opened or is no regular file.  Raises
        ``DiagnosticError`` (``bus-locked``) if another flash uses the journal file.
        """
        self.name = str(path)
        self._path = path
        self._is_new = not path.exists()
        if not self._is_new:
            check_regular(os.stat(path))
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise DiagnosticError(
                "bus-locked",
                f"another flash writes the journal {path}",
                hint="wait until it has finished",
            ) from None
        if self._is_new:
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def read(self) -> bytes:
        parts, offset = [], 0
        while data := os.pread(self._file, 1 << 20, offset):
            parts.append(data)
            offset += len(data)
            if offset > MAX_BYTES:
                raise unreadable(self.name, f"it has more than {MAX_BYTES / 1e6:g} MB")
        return b"".join(parts)

    def append(self, data: bytes) -> None:
        append_whole(self._file, data, sync=True)

    def close(self) -> None:
        """Closes the journal file.  Deletes the journal file if it is new and still empty."""
        if self._is_new and os.fstat(self._file).st_size == 0:
            self._path.unlink(missing_ok=True)
        os.close(self._file)


@dataclass(frozen=True, slots=True)
class Run:
    """One execution (run) of a flash, as recorded in the journal.

    - ``mode``: ``apply``, ``resume`` or ``rollback``;
    - ``plan``: plan of the run;
    - ``records``: records of the run after the plan.
    """

    mode: str
    plan: Plan
    records: tuple[dict[str, Any], ...]

    @property
    def finished(self) -> bool:
        return any(record["record"] == "end" for record in self.records)

    @property
    def started_steps(self) -> list[int]:
        """Indices of the started steps in the commissioning plan (starting at 0), in the order of
        execution."""
        return [record["step"] for record in self.records if record["record"] == "begin"]

    def previous_values(self) -> list[tuple[str, tuple[bus_configuration.ParameterValue, ...]]]:
        """Returns the node and the previous object values for each journal record of a step that
        writes object values."""
        return [(record["node"], _values(record)) for record in self.records if "old" in record]


def unreadable(name: str, reason: str) -> DiagnosticError:
    """Returns the error for a file ``name`` that is not a journal."""
    return DiagnosticError(
        "journal-unreadable",
        f"{name} is not the journal of a flash: {reason}",
        hint="name another file with --journal, and keep this one as a record",
    )


class Journal:
    """Journal of all flashes of one CAN bus of a robot."""

    def __init__(self, storage: Storage) -> None:
        """Reads all records of the journal.

        Raises ``DiagnosticError`` (``journal-unreadable``) if the file is not a journal of a flash.
        """
        self.storage = storage
        self._data = storage.read()
        self._link = b""
        self._is_in_doubt = False
        """``True`` if an append did not return: only the file says whether it has the record."""
        self.runs = self._read(self._data)

    @property
    def chain(self) -> list[Run]:
        """Last flash run with the mode ``apply``, and all later runs in the journal."""
        for index in range(len(self.runs) - 1, -1, -1):
            if self.runs[index].mode == APPLY:
                return self.runs[index:]
        return []

    @property
    def unfinished(self) -> Run | None:
        """Last flash run in the journal, or ``None`` if the last run is finished."""
        return self.runs[-1] if self.runs and not self.runs[-1].finished else None

    def refuse_unfinished(self) -> None:
        """Raises ``DiagnosticError`` (``journal-mismatch``) if the last run is not finished."""
        if self.unfinished is not None:
            kind = "rollback" if self.unfinished.mode == ROLLBACK else "flash"
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.storage.name} contains an unfinished {kind}",
                hint="continue it with --resume, or undo it with --rollback",
            )

    def start(self, mode: str, plan: Plan) -> None:
        self._append(
            {
                "record": "run",
                "format": FORMAT,
                "version": VERSION,
                "mode": mode,
                "hash": plan.hash,
                "robot": plan.configuration.robot,
                "bus": plan.configuration.bus,
                "plan": plan_to_json(plan),
            }
        )

    def begin(
        self,
        step: int,
        node: str,
        description: str,
        old: Sequence[bus_configuration.ParameterValue] = (),
    ) -> None:
        """Writes a record to the journal at the start of a step.

        ``old``: previous values of the objects that the step writes.
        """
        record: dict[str, Any] = {
            "record": "begin",
            "step": step,
            "node": node,
            "what": description,
        }
        if old:
            record["old"] = [asdict(value) for value in old]
        self._append(record)

    def done(self, step: int, node: str, read: Any) -> None:
        """Writes a record to the journal at the end of a step, with the values that were read back
        from the node."""
        self._append({"record": "done", "step": step, "node": node, "read": read})

    def stop(self, reason: str) -> None:
        self._append({"record": "stopped", "reason": reason})

    def end(self) -> None:
        self._append({"record": "end"})

    # -- inside -----------------------------------------------------------------------------

    def _append(self, record: dict[str, Any]) -> None:
        if self._is_in_doubt:
            self._data, self._link = self.storage.read(), b""
            self._read(self._data)
        text = json.dumps(record, separators=(",", ":"), ensure_ascii=True).encode()[:-1]
        link = _next_link(self._link, text)
        line = b'%s,"chain":"%s"}\n' % (text, link)
        if self._data and not self._data.endswith(b"\n"):
            line = b"\n" + line
        self._data = b"\n"
        self._is_in_doubt = True
        try:
            self.storage.append(line)
        except OSError as error:
            self._is_in_doubt = False
            raise DiagnosticError(
                "journal-unreadable",
                f"cannot write the journal {self.storage.name}: {error.strerror or error}",
                hint="nothing was written to the bus since its last line; free disk space, or name "
                "another file with --journal",
            ) from None
        self._link = link
        self._is_in_doubt = False

    def _read(self, data: bytes) -> list[Run]:
        runs: list[tuple[str, Plan, list[dict[str, Any]]]] = []
        torn = 0
        for number, line in enumerate(data.split(b"\n"), 1):
            if not line.strip():
                continue
            complete = _LINE.fullmatch(line)
            if complete is not None:
                self._link = _next_link(self._link, complete[1])
                if self._link != complete[2]:
                    raise self._unreadable(
                        f"line {number} does not follow the line before it: a record was changed,"
                        " deleted, doubled or moved"
                    )
            try:
                if complete is None:
                    raise ValueError(line)
                record = read_json(complete[1] + b"}")
                kind = record["record"]
                if kind == "run":
                    plan = self._plan(record, number)
                    runs.append((record["mode"], plan, []))
                    torn = 0
                    continue
                self._check(record)
            except (ValueError, KeyError, TypeError, AttributeError):
                # An incomplete line is the beginning of a journal record that a power cut has
                # interrupted.  An incomplete line of the journal is valid only at the end of the
                # file or before a new run.
                if torn or not (line.startswith(_HEAD) or _HEAD.startswith(line)):
                    raise self._unreadable(f"line {number} is not a record") from None
                torn = number
                continue
            if torn:
                raise self._unreadable(f"line {torn} is damaged")
            if not runs:
                raise self._unreadable("it does not begin with a plan")
            runs[-1][2].append(record)
        return [Run(mode, plan, tuple(records)) for mode, plan, records in runs]

    def _plan(self, record: dict[str, Any], number: int) -> Plan:
        if record["format"] != FORMAT or record["version"] != VERSION:
            raise self._unreadable(
                f"line {number} has the format `{record['format']}`, version {record['version']};"
                f" this program reads `{FORMAT}`, version {VERSION}"
            )
        plan = plan_from_json(record["plan"])
        if plan.hash != record["hash"] or record["mode"] not in (APPLY, RESUME, ROLLBACK):
            raise self._unreadable(f"the plan in line {number} was changed by hand")
        return plan

    def _check(self, record: dict[str, Any]) -> None:
        kind = record["record"]
        if kind in ("begin", "done"):
            if type(record["step"]) is not int or record["step"] < 0:
                raise ValueError(kind)
            if not isinstance(record["node"], str):
                raise ValueError(kind)
            bus_configuration.check_values(_values(record))
        elif kind not in ("stopped", "end"):
            raise ValueError(kind)

    def _unreadable(self, reason: str) -> DiagnosticError:
        return unreadable(self.storage.name, reason)


def _values(record: dict[str, Any]) -> tuple[bus_configuration.ParameterValue, ...]:
    """Returns the previous values of a record.  Raises ``ValueError`` for anything else."""
    values: tuple[bus_configuration.ParameterValue, ...] = typed_value(
        tuple[bus_configuration.ParameterValue, ...], record.get("old", [])
    )
    return values


def _next_link(link: bytes, text: bytes) -> bytes:
    """Returns the link of the chain after a record."""
    return hashlib.sha256(link + text).hexdigest()[:32].encode()
