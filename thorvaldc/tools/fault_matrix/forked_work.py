"""Continues one simulation in many processes, each of which has its own copy of the simulation.

    parent   start-up ---- ready ------------------ driving ----------
                             |  fork: a copy for     |
    child                    +- each fault           +- each fault

A fork copies the whole state of the process.  The start-up of the robot is thus simulated once for
all faults.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from thorvaldc.simulation.worker_processes import become_worker

T = TypeVar("T")


class WorkError(RuntimeError):
    """A process ended with an exception.  The message contains the traceback of the process."""


def can_fork() -> bool:
    """Returns ``True`` if the process can be copied: other threads would not be copied."""
    return hasattr(os, "fork") and threading.active_count() == 1


def run_forked(work: Sequence[Callable[[], T]], jobs: int) -> Iterator[tuple[int, T]]:
    """Calls each function in a copy of this process, and yields its index and its result.

    At most ``jobs`` copies run at the same time.  The results come in any order.  Raises
    ``WorkError`` if a function raises an exception.  Ends the copies if the iterator is closed.
    """
    context = multiprocessing.get_context("fork")
    waiting = list(enumerate(work))
    running: dict[Connection, tuple[int, Any]] = {}
    # A garbage collection in a copy would touch, and so copy, the memory of the whole simulation.
    gc.collect()
    gc.freeze()
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                index, function = waiting.pop(0)
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=_work, args=(function, sender))
                process.start()
                sender.close()
                running[receiver] = index, process
            ready = wait(list(running))
            for receiver in [candidate for candidate in running if candidate in ready]:
                index, process = running.pop(receiver)
                yield index, _result(receiver)
                process.join()
    finally:
        gc.unfreeze()
        for _, process in running.values():
            process.terminate()
            process.join()


def _result(receiver: Connection) -> Any:
    try:
        failed, result = receiver.recv()
    except EOFError:
        raise WorkError("a process was killed") from None
    finally:
        receiver.close()
    if failed:
        raise WorkError(result)
    return result


def _work(function: Callable[[], Any], sender: Connection) -> None:
    become_worker()
    gc.disable()
    try:
        sender.send((False, function()))
    except BaseException:
        sender.send((True, traceback.format_exc()))
    finally:
        sender.close()
