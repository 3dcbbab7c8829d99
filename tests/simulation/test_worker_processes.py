"""No worker process outlives its parent: a reader of their common output reaches its end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from thorvaldc.simulation.worker_processes import ignored_interrupts

POOL = """
import os, sys, time
from thorvaldc.simulation.worker_processes import ignored_interrupts, worker_pool

def work(number):
    os.write(1, b"working\\n")  # one call, so that the lines of two workers stay apart
    time.sleep(600)

if __name__ == "__main__":
    with worker_pool(2) as pool:
        with ignored_interrupts():
            futures = [pool.submit(work, number) for number in range(4)]
        futures[0].result()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_the_end_of_the_parent_ends_its_workers(tmp_path: Path, number: signal.Signals) -> None:
    end_the_parent(tmp_path, POOL, number)


def end_the_parent(tmp_path: Path, program: str, number: signal.Signals) -> None:
    """Runs a program with two workers, ends it by a signal, and waits for the end of its output."""
    script = tmp_path / "program.py"
    script.write_text(program)
    process = ChildProcess(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    assert [process.stdout.readline() for _ in range(2)] == ["working\n"] * 2
    process.send_signal(number)
    rest, _ = process.communicate(timeout=300)  # waits until no process holds the pipe
    assert (rest, process.returncode) == ("", -number)


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Windows has no such masks")
def test_an_interrupt_during_the_start_of_workers_comes_after_it() -> None:
    reached = []

    def start() -> None:
        with ignored_interrupts():
            signal.raise_signal(signal.SIGINT)
            reached.append(True)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            start()
    finally:
        signal.signal(signal.SIGINT, handler)
    assert reached
