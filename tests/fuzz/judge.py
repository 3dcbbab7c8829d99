"""Runs the command of a case in a copy of this process, and judges what it did.

The process that judges has imported the program once; ``fork`` makes a copy for each case, which
takes milliseconds.
"""

from __future__ import annotations

import ctypes
import gc
import hashlib
import os
import resource
import select
import shutil
import signal
import socket
import stat
import sys
import tempfile
import time
import traceback
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.generator import Case
from tests.fuzz.products import run_quietly
from thorvaldc.cli.exits import DONE, INPUT, OUTSIDE, USAGE
from thorvaldc.cli.main import run_command

MAX_MEMORY = 500_000_000
USUAL_MEMORY = 150_000_000
"""Memory of ``python -m tests.fuzz`` before a case (bytes); a process of pytest may have more."""
MAX_CPU = 20
"""Limit of the processor time of a command (s)."""
MAX_WALL = 300.0
"""A command that waits, and needs no processor, is ended after this time (s)."""
MAX_TEXT = 200_000
"""Limit of the output for people; JSON has all diagnostics."""
ON_BUS = ("can scan", "can verify", "can flash")
"""Commands that may name a device on the bus in place of a file."""
CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH, PR_CAPBSET_DROP = 1, 2, 24


@dataclass(frozen=True)
class Verdict:
    """What a command did.

    - ``violations``: each is one line; empty if the command behaved.
    - ``cpu``, ``wall``: s; ``memory``: peak of the resident memory in bytes.
    """

    violations: tuple[str, ...]
    status: int
    cpu: float
    wall: float
    memory: int
    output: str


def prepare() -> None:
    """Imports what the commands import, so that the copies share it."""
    import mujoco  # noqa: F401
    import rosbags.highlevel  # noqa: F401

    import thorvaldc.compiler.extras.load_extras  # noqa: F401

    for command in ("check", "build", "sim", "scenario", "batch", "run", "calibrate"):
        with suppress(RuntimeError):
            run_quietly(command, "missing.yaml")
    gc.collect()
    gc.freeze()


@contextmanager
def case_folder(case: Case, parent: Path | None = None) -> Iterator[Path]:
    """Writes the files of a case into a new folder, which is deleted at the end."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz_", dir=parent))
    folder.chmod(0o755)
    try:
        work = folder / "work"
        work.mkdir()
        (folder / "tmp").mkdir()
        (folder / "tmp").chmod(0o777)
        for name, data in case.files.items():
            path = work / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        (work / "zero").symlink_to("/dev/zero")
        os.mkfifo(work / "pipe")
        (work / "loop").symlink_to("loop")
        (work / "folder").mkdir()
        if case.special:
            _make_special(case.special, work / case.file)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _make_special(special: str, path: Path) -> None:
    data = path.read_bytes()
    path.unlink()
    if special == "folder":
        path.mkdir()
    elif special == "pipe":
        os.mkfifo(path)
    elif special == "device":
        path.symlink_to("/dev/zero")
    elif special == "loop":
        path.symlink_to(path.name)
    elif special == "not permitted":
        path.write_bytes(data)
        path.chmod(0)
    elif special == "huge":
        path.write_bytes(data)
        os.truncate(path, 2**33)
    elif special == "socket":
        short = Path(tempfile.mkdtemp(prefix="s"))  # a socket's path has at most 107 bytes
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(short / "s"))
        os.rename(short / "s", path)
        short.rmdir()


def judge(case: Case, parent: Path | None = None) -> Verdict:
    """Runs the command of a case and returns what it did."""
    with case_folder(case, parent) as folder:
        before = _snapshot(folder / "work")
        start = time.monotonic()
        child = os.fork()
        if child == 0:
            _run_child(case, folder)
        timed_out = not _wait(child)
        left = _end_group(child)
        _, wait_status, usage = os.wait4(child, 0)
        wall = time.monotonic() - start
        status = os.waitstatus_to_exitcode(wait_status)
        output = (folder / "output").read_bytes()[:MAX_TEXT].decode("utf-8", "replace")
        violations = []
        if timed_out or status == -signal.SIGXCPU:
            violations.append("hang: " + ("waits for ever" if timed_out else f"{MAX_CPU} s of CPU"))
        elif status < 0:
            violations.append(f"ended by signal {-status}")
        elif left:
            violations.append("left a process")
        memory = usage.ru_maxrss * 1024
        # The command runs in a copy of this process, which has the memory of this process.
        if memory > MAX_MEMORY + max(0, _resident() - USUAL_MEMORY):
            violations.append(f"memory: {memory / 1e6:.0f} MB")
        violations += _judge_output(case, status, output)
        violations += _judge_files(case, before, folder)
        cpu = usage.ru_utime + usage.ru_stime
        return Verdict(tuple(violations), status, cpu, wall, memory, output)


def _resident() -> int:
    """Returns the memory of this process in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def _run_child(case: Case, folder: Path) -> None:
    """Runs the command and ends the process."""
    status = 99
    try:
        os.setsid()
        output = os.open(folder / "output", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        null = os.open(os.devnull, os.O_RDONLY)
        for number, source in ((0, null), (1, output), (2, output)):
            os.dup2(source, number)
        sys.stdin, sys.stdout, sys.stderr = (
            open(n, mode, encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
            for n, mode in ((0, "r"), (1, "w"), (2, "w"))
        )
        os.chdir(folder / "work")
        os.environ |= {"TMPDIR": str(folder / "tmp"), "XDG_RUNTIME_DIR": str(folder / "tmp")}
        os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
        tempfile.tempdir = None
        sys.path.append(str(folder / "work/plugins"))
        sys.argv = ["thorvaldc", *case.command.split()]
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU, MAX_CPU + 5))
        resource.setrlimit(resource.RLIMIT_FSIZE, (2**30, 2**30))
        resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))  # keeps the machine alive
        if case.special == "not permitted" and os.geteuid() == 0:
            _obey_permissions()
        earlier = set(weakref.finalize._registry)  # type: ignore[attr-defined]
        try:
            status = run_command()
            for finalizer in set(weakref.finalize._registry) - earlier:  # type: ignore[attr-defined]
                finalizer()  # as at the end of a process
        except BaseException:
            traceback.print_exc()
            status = 70
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    finally:
        os._exit(status)


def _obey_permissions() -> None:
    """Takes away the rights of the superuser to read and write every file (Linux)."""
    library = ctypes.CDLL(None, use_errno=True)
    for right in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH):
        library.prctl(PR_CAPBSET_DROP, right, 0, 0, 0)  # also of the programs that it starts
    rights = 0xFFFFFFFF & ~(1 << CAP_DAC_OVERRIDE | 1 << CAP_DAC_READ_SEARCH)
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)
    sets = (ctypes.c_uint32 * 6)()
    library.capget(header, sets)
    for i in range(3):  # effective, permitted, inheritable
        sets[i] &= rights
    library.capset(header, sets)


def _wait(child: int) -> bool:
    """Waits until a process ends.  Returns whether it ended in time."""
    handle = os.pidfd_open(child)
    try:
        return bool(select.select([handle], [], [], MAX_WALL)[0])
    finally:
        os.close(handle)


def _end_group(child: int) -> bool:
    """Ends the processes of a session.  Returns whether other processes than its first ran."""
    left = False
    for entry in os.listdir("/proc"):
        if entry.isdecimal() and int(entry) != child:
            with suppress(OSError, IndexError, ValueError):
                fields = Path("/proc", entry, "stat").read_text().rpartition(")")[2].split()
                left |= int(fields[3]) == child and fields[0] != "Z"
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return left


# -- judging ------------------------------------------------------------------------------


def _judge_output(case: Case, status: int, output: str) -> list[str]:
    violations = []
    if "Traceback (most recent call last)" in output or "internal error" in output.lower():
        last = [line for line in output.splitlines() if line and not line.startswith(" ")][-1:]
        violations.append(f"traceback: {''.join(last)[:300]}")
    elif status >= 0 and status not in (DONE, INPUT, OUTSIDE, USAGE):
        violations.append(f"exit status {status}")
    if status in (INPUT, OUTSIDE):
        # A model names the robot file that it was built from.
        names = {Path(name).name for name in case.files} | {"one.yaml"}
        if case.special:
            names = {Path(case.file).name, str(Path(case.file).parent)} - {"."}
        if not output.strip():
            violations.append("fails without a message")
        elif not case.command.startswith(ON_BUS) and not any(name in output for name in names):
            violations.append("the output names no file")
    if len(output) >= MAX_TEXT and "json" not in case.command and "--format" not in case.command:
        violations.append(f"prints more than {MAX_TEXT / 1000:.0f} kB")
    return violations


def _snapshot(work: Path) -> dict[str, str]:
    """Returns kind, permissions and content of everything in a folder, by path."""
    content = {}
    for path in sorted(work.rglob("*")):
        status = path.lstat()
        text = f"{stat.filemode(status.st_mode)} {status.st_size}"
        if stat.S_ISREG(status.st_mode) and status.st_size < 2**24:
            text += hashlib.sha256(path.read_bytes()).hexdigest()
        content[path.relative_to(work).as_posix()] = text
    return {name: text for name, text in content.items() if not text.startswith("d")}


def _judge_files(case: Case, before: dict[str, str], folder: Path) -> list[str]:
    after = _snapshot(folder / "work")
    changed = [name for name in {*before, *after} if before.get(name) != after.get(name)]
    violations = [
        f"changed {name}"
        for name in sorted(changed)
        if not name.startswith((*case.kind.writes, "out.html"))
    ]
    left = sorted(path.name for path in (folder / "tmp").iterdir())
    return violations + [f"left {name} in the folder for temporary files" for name in left]
