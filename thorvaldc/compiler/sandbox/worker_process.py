"""Starts and limits the processes that read files of others.

Files of others (xacro, meshes) can contain programs, or need any amount of time and memory.  The
compiler reads them only in limited worker processes, see ``worker_protocol``.  In a web browser,
which starts no processes, the program that runs the compiler has these limits.

Begin with ``limited_worker``.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from thorvaldc.compiler.sandbox import missing_limits, worker_protocol
from thorvaldc.compiler.sandbox.worker_protocol import Fields, read_message, write_message
from thorvaldc.diagnostics.files import read_json

_ROOT = str(Path(worker_protocol.__file__).parents[3])
_PROGRAM = (
    f"import sys; sys.path.append({_ROOT!r}); "
    "from thorvaldc.compiler.sandbox.worker_protocol import main; main()"
)
START_SECONDS = 120.0
"""Time in which a worker process must start and import its modules."""


@dataclass(frozen=True, slots=True)
class WorkerLimits:
    """Limits of a worker process.

    - ``wall_seconds``, ``processor_seconds``: time and processor time of one request (s).
    - ``memory_bytes``: address space of the process (bytes).
    - ``file_bytes``: size of a file that the process may write (bytes).
    - ``answer_bytes``: size of the fields of an answer, and of its data (bytes).
    """

    wall_seconds: float
    processor_seconds: int
    memory_bytes: int
    file_bytes: int = 0
    answer_bytes: int = 64 << 20


class WorkerLimitError(Exception):
    """Raised if a worker process exceeded a limit or ended.

    The text is the predicate of a sentence, such as ``took longer than 10 s``.
    """


class Worker:
    """Answers one request at a time with the module ``service``, see ``worker_protocol``."""

    def __init__(self, limits: WorkerLimits) -> None:
        self.limits = limits

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def ask(self, request: Fields, data: bytes = b"") -> tuple[Fields, bytes]:
        """Sends a request, and returns the answer and its data.

        Raises ``WorkerLimitError`` if the answer exceeds a limit, or if the worker ends.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Ends the worker."""


def limited_worker(
    service: str,
    limits: WorkerLimits,
    *,
    path: Sequence[str] = (),
    imports: Sequence[str] = (),
    has_processes: bool = sys.platform != "emscripten",
) -> Worker:
    """Returns a worker: a limited process, or in a web browser this process.

    - ``service``: name of the module that answers, see ``worker_protocol``.
    - ``path``: folders from which a process imports modules, beside the standard library and
      this package.
    - ``imports``: modules that a process imports before its limits are in force.
    - ``has_processes``: whether the system can start processes.
    """
    if not has_processes:
        return _WorkerInProcess(service, limits)
    return _WorkerProcess(service, limits, path, imports)


class _WorkerInProcess(Worker):
    """Answers in this process.  Its time and memory have no limits but those of this process."""

    def __init__(self, service: str, limits: WorkerLimits) -> None:
        super().__init__(limits)
        self._service = service

    def ask(self, request: Fields, data: bytes = b"") -> tuple[Fields, bytes]:
        service = importlib.import_module(self._service)
        try:
            with contextlib.chdir("."):  # a service may change the folder
                answer, data = service.answer(read_json(json.dumps(request)), data)
            return read_json(json.dumps(answer)), data
        except MemoryError as error:
            raise WorkerLimitError("needs more memory than there is") from error
        except RecursionError as error:
            raise WorkerLimitError("is nested too deeply") from error
        except Exception as error:  # as if it had ended a process
            raise WorkerLimitError(f"ended its reader ({error})") from error


class _WorkerProcess(Worker):
    """A limited process.

    The process starts with the first request.  If a request fails, the next one starts a new
    process.
    """

    def __init__(
        self, service: str, limits: WorkerLimits, path: Sequence[str], imports: Sequence[str]
    ) -> None:
        super().__init__(limits)
        self._start_fields: Fields = {
            "service": service,
            "path": [*path],
            "imports": [*imports],
            "memory_bytes": limits.memory_bytes,
            "file_bytes": limits.file_bytes,
            "processor_seconds": limits.processor_seconds,
            "parent": os.getpid(),
        }
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, request: Fields, data: bytes = b"") -> tuple[Fields, bytes]:
        try:
            if self._process is None:
                self._process = _start()
                limited, _ = self._exchange(START_SECONDS, self._start_fields)
                if limited["missing"] and limited["missing"] not in missing_limits:
                    missing_limits.append(limited["missing"])
            answer, data = self._exchange(self.limits.wall_seconds, request, data)
        except BaseException:
            self.close()
            raise
        if "exceeded" in answer:
            self.close()
            gigabytes = self.limits.memory_bytes / (1 << 30)
            raise WorkerLimitError(
                f"needs more than {gigabytes:g} GB of memory"
                if answer["exceeded"] == "memory"
                else "is nested too deeply"
            )
        return answer, data

    def close(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        _kill(process)
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def _exchange(self, seconds: float, request: Fields, data: bytes = b"") -> tuple[Fields, bytes]:
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            raise OSError("the worker process has no pipes")
        timed_out = threading.Event()

        def stop() -> None:
            timed_out.set()
            _kill(process)

        timer = threading.Timer(seconds, stop)
        timer.daemon = True
        timer.start()
        try:
            with contextlib.suppress(BrokenPipeError):
                write_message(process.stdin, request, data)
            return read_message(process.stdout, self.limits.answer_bytes)
        except OverflowError as error:
            megabytes = self.limits.answer_bytes >> 20
            raise WorkerLimitError(f"gives a result of more than {megabytes} MB") from error
        except (EOFError, ValueError, RecursionError) as error:
            if timed_out.is_set():
                raise WorkerLimitError(f"took longer than {seconds:g} s") from error
            _kill(process)
            status = process.wait()
            if status == -getattr(signal, "SIGXCPU", 24):
                limit = self.limits.processor_seconds
                raise WorkerLimitError(f"took longer than {limit} s of processor time") from error
            raise WorkerLimitError(f"ended its reader process (exit status {status})") from error
        finally:
            timer.cancel()


def _start() -> subprocess.Popen[bytes]:
    environment = {"LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "0"}
    # The memory of each thread would count for the limit of memory.
    environment["OPENBLAS_NUM_THREADS"] = "1"
    # Bags are unpacked in TMPDIR. Windows cannot start a process without SYSTEMROOT.
    for name in {"SYSTEMROOT", "TMPDIR"} & os.environ.keys():
        environment[name] = os.environ[name]
    return subprocess.Popen(
        # The Python options of the worker exclude the site packages, the folder of the user and the
        # folder of the script from the module path.  The Python option -B prevents the writing of
        # .pyc files.
        [sys.executable, "-s", "-S", "-P", "-B", "-c", _PROGRAM],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        # The worker process runs in a separate process session and does not receive Ctrl-C.  The
        # compiler receives Ctrl-C and then ends the worker process.
        start_new_session=True,
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Ends the worker process and its child processes with the signal SIGKILL."""
    if process.poll() is not None:
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
