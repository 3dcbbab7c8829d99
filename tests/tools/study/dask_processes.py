"""A Dask scheduler and Dask workers as child processes, which end with the test."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from tests.child_process import ChildProcess

ROOT = Path(__file__).parents[3]


class DaskProcesses:
    """A scheduler on a free port of this computer, and its workers."""

    def __init__(self, workers: int = 0) -> None:
        with closing(socket.socket()) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.workers: list[ChildProcess] = []
        self.start_scheduler()
        for _ in range(workers):
            self.start_worker()

    def start_scheduler(self, **environment: str) -> None:
        self.scheduler = _dask(
            *("scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"),
            **environment,
        )
        end = time.monotonic() + 300
        while time.monotonic() < end:
            with closing(socket.socket()) as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.05)
        raise TimeoutError("the scheduler does not start")

    def start_worker(self, threads: int = 1, **environment: str) -> ChildProcess:
        """Starts a worker without a nanny, so that a kill of the process is one of the worker."""
        worker = _dask(
            *("worker", self.address, "--nthreads", str(threads), "--no-nanny", "--no-dashboard"),
            **environment,
        )
        self.workers.append(worker)
        return worker

    def close(self) -> None:
        for process in (self.scheduler, *self.workers):
            process.end()


def _dask(*words: str, **environment: str) -> ChildProcess:
    paths = {"PYTHONPATH": str(ROOT), "DASK_TEMPORARY_DIRECTORY": os.fspath(Path.cwd())}
    return ChildProcess(
        [sys.executable, "-m", "dask", *words],
        env={**os.environ, **paths, **environment},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
