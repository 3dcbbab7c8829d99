"""What was done to a bus, line by line, on the disk before and after each step.

A file of JSON, one record a line, only ever appended to.  A line that a power cut tore is
passed over: the bus itself is the truth, the journal says what was meant and what was there before.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from thorvaldc.commissioning.bus_configuration import (
    ParameterValue,
    values_from_json,
    values_to_json,
)
from thorvaldc.commissioning.plan import Plan, plan_from_json, plan_to_json
from thorvaldc.diagnostics.error import DiagnosticError

FORMAT, VERSION = "thorvaldc-flash", 1
APPLY, RESUME, ROLLBACK = "apply", "resume", "rollback"
_HEAD = b'{"record":"'


class Store(Protocol):
    """Where the lines are kept."""

    name: str

    def read(self) -> bytes: ...

    def append(self, data: bytes) -> None:
        """On its return the bytes have reached the disk."""

    def close(self) -> None: ...


class JournalFile:
    """A file, locked for this process while it is open."""

    def __init__(self, path: Path) -> None:
        """Raises ``OSError``, and ``DiagnosticError`` (``bus-locked``) if it is open elsewhere."""
        self.name = str(path)
        self._path = path
        self._fresh = not path.exists()
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
        if self._fresh:
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def read(self) -> bytes:
        parts, at = [], 0
        while data := os.pread(self._file, 1 << 20, at):
            parts.append(data)
            at += len(data)
        return b"".join(parts)

    def append(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._file, data) :]
        os.fsync(self._file)

    def close(self) -> None:
        """A file that was made for nothing is taken away."""
        if self._fresh and os.fstat(self._file).st_size == 0:
            self._path.unlink(missing_ok=True)
        os.close(self._file)


@dataclass(frozen=True, slots=True)
class Run:
    """A run as the journal has it: ``mode``, plan, and what followed."""

    mode: str
    plan: Plan
    records: tuple[dict[str, Any], ...]

    @property
    def finished(self) -> bool:
        return any(record["record"] == "end" for record in self.records)

    @property
    def begun(self) -> list[int]:
        """The steps (from 0) that were begun, in order."""
        return [record["step"] for record in self.records if record["record"] == "begin"]

    @property
    def done(self) -> list[int]:
        return [record["step"] for record in self.records if record["record"] == "done"]

    def old(self) -> list[tuple[str, tuple[ParameterValue, ...]]]:
        """By node, in order, what was there before of what was to be changed."""
        return [
            (record["node"], values_from_json(record["old"]))
            for record in self.records
            if "old" in record
        ]


class Journal:
    def __init__(self, store: Store) -> None:
        """Raises ``DiagnosticError`` (``journal-unreadable``) where it is no journal."""
        self.store = store
        self._data = store.read()
        self.runs = self._read(self._data)

    @property
    def chain(self) -> list[Run]:
        """The last run that was begun afresh, and those that went on with it."""
        for place in range(len(self.runs) - 1, -1, -1):
            if self.runs[place].mode == APPLY:
                return self.runs[place:]
        return []

    @property
    def unfinished(self) -> Run | None:
        """The last run, where it did not come to its end."""
        return self.runs[-1] if self.runs and not self.runs[-1].finished else None

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

    def begin(self, step: int, node: str, words: str, old: Sequence[ParameterValue] = ()) -> None:
        """Before a step; ``old``: what is there now of what will be changed."""
        record: dict[str, Any] = {"record": "begin", "step": step, "node": node, "what": words}
        if old:
            record["old"] = values_to_json(old)
        self._append(record)

    def done(self, step: int, node: str, read: Any) -> None:
        """After a step: what was read back."""
        self._append({"record": "done", "step": step, "node": node, "read": read})

    def stop(self, reason: str) -> None:
        self._append({"record": "stopped", "reason": reason})

    def end(self) -> None:
        self._append({"record": "end"})

    def close(self) -> None:
        self.store.close()

    # -- inside -----------------------------------------------------------------------------

    def _append(self, record: dict[str, Any]) -> None:
        line = json.dumps(record, separators=(",", ":"), ensure_ascii=True).encode() + b"\n"
        if self._data and not self._data.endswith(b"\n"):
            line = b"\n" + line
        self._data = b"\n"
        try:
            self.store.append(line)
        except OSError as fault:
            raise DiagnosticError(
                "journal-unreadable",
                f"cannot write the journal {self.store.name}: {fault.strerror or fault}",
                hint="nothing was written to the bus since its last line; name another file "
                "by --journal, or make room",
            ) from None

    def _read(self, data: bytes) -> list[Run]:
        runs: list[tuple[str, Plan, list[dict[str, Any]]]] = []
        torn = 0
        for number, line in enumerate(data.split(b"\n"), 1):
            if not line.strip():
                continue
            try:
                record = json.loads(line)
                kind = record["record"]
                if kind == "run":
                    plan = self._plan(record, number)
                    runs.append((record["mode"], plan, []))
                    torn = 0
                    continue
                self._check(record)
            except (ValueError, KeyError, TypeError, AttributeError):
                # A cut leaves the beginning of a record, and nothing but another run behind it.
                if torn or not (line.startswith(_HEAD) or _HEAD.startswith(line)):
                    raise self._fault(f"line {number} is no record of it") from None
                torn = number
                continue
            if torn:
                raise self._fault(f"line {torn} is damaged")
            if not runs:
                raise self._fault("it does not begin with a plan")
            runs[-1][2].append(record)
        return [Run(mode, plan, tuple(records)) for mode, plan, records in runs]

    def _plan(self, record: dict[str, Any], number: int) -> Plan:
        if record["format"] != FORMAT or record["version"] != VERSION:
            raise self._fault(f"line {number} has another format or version")
        plan = plan_from_json(record["plan"])
        if plan.hash != record["hash"] or record["mode"] not in (APPLY, RESUME, ROLLBACK):
            raise self._fault(f"the plan in line {number} was changed by hand")
        return plan

    def _check(self, record: dict[str, Any]) -> None:
        kind = record["record"]
        if kind in ("begin", "done"):
            if not isinstance(record["step"], int) or not isinstance(record["node"], str):
                raise ValueError(kind)
            values_from_json(record.get("old", ()))
        elif kind not in ("stopped", "end"):
            raise ValueError(kind)

    def _fault(self, what: str) -> DiagnosticError:
        return DiagnosticError(
            "journal-unreadable",
            f"{self.store.name} is no journal of a flash: {what}",
            hint="name another file by --journal; keep this one, it may say what was done",
        )
