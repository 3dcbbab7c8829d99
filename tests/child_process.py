"""Processes that tests start: none outlives its test, also if the test fails or is ended."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar


class ChildProcess(subprocess.Popen[Any]):
    """A ``Popen`` in a session of its own, whose children are ended with it.

    ``subprocess.Popen`` waits at the end of its ``with`` block, also after a failed assertion, for
    a process that nothing ends any more.  This class ends the process in that case.
    """

    running: ClassVar[list[ChildProcess]] = []

    def __init__(self, command: list[str], **options: Any) -> None:
        super().__init__(command, **{"start_new_session": True, **options})
        self.running.append(self)

    def __exit__(self, *error: Any) -> None:
        if error[0] is not None:
            self.end()
        super().__exit__(*error)

    def end(self) -> None:
        """Kills the process and its children, and closes its pipes."""
        if self in self.running:
            self.running.remove(self)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        self.wait()
        for pipe in (self.stdin, self.stdout, self.stderr):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def end_at_hang_up() -> None:
    """For ``preexec_fn``: under nohup, tests and their children would ignore SIGHUP."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def before_other_processes() -> None:
    """For ``preexec_fn`` of programs in real time: a busy computer does not make them late.

    Without the right to it, the program runs as any other.
    """
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))


@contextmanager
def ended_processes() -> Iterator[None]:
    """Ends the processes that start in the ``with`` block."""
    before = list(ChildProcess.running)
    try:
        yield
    finally:
        for process in [p for p in ChildProcess.running if p not in before]:
            process.end()


def is_running(pid: int | str) -> bool:
    """Checks whether a process runs, by ``/proc``.

    A process that has ended stays in ``/proc`` until its parent collects its status; the parent of
    an orphan is process 1, which takes its time on a loaded machine.
    """
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return status.rpartition(")")[2].split()[0] not in "ZX"
