"""Worker processes that never outlive the process that started them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Any


@contextmanager
def worker_pool(
    count: int, prepare: Callable[[], None] | None = None, *, may_fork: bool = False
) -> Iterator[ProcessPoolExecutor]:
    """Opens a pool of ``count`` worker processes, each of which calls ``prepare`` first.

    ``may_fork``: whether the workers may be copies of this process, which start in a tenth of the
    time.  The caller must have no worker process of its own open.

    Submit all work in the ``with`` block under ``ignored_interrupts``.  If an exception leaves the
    block, also Ctrl-C, the workers are terminated and the remaining work is cancelled.
    """
    # A forked process would inherit the locks of other threads, which numpy and MuJoCo start too.
    is_single = threading.active_count() == 1 and not {"numpy", "mujoco"} & set(sys.modules)
    is_forked = may_fork and is_single and sys.platform == "linux"
    context: Any = multiprocessing.get_context("fork" if is_forked else "spawn")
    pool = ProcessPoolExecutor(
        count, mp_context=context, initializer=become_worker, initargs=(prepare,)
    )
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def become_worker(prepare: Callable[[], None] | None = None) -> None:
    """Makes the current process a worker of its parent process, and calls ``prepare``.

    A worker ignores Ctrl-C, which a terminal sends to all processes: the parent process ends its
    workers itself.  A parent process that is killed cannot do so; its workers then end themselves.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):  # its own children begin without `ignored_interrupts`
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    threading.Thread(target=_end_after_parent, daemon=True).start()
    if prepare is not None:
        prepare()


def _end_after_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def ignored_interrupts() -> Iterator[None]:
    """Makes all child processes ignore Ctrl-C that start in the ``with`` block.

    A child process that does not ignore Ctrl-C during its start would print a traceback.  This
    process is interrupted at the end of the block at the latest.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if not hasattr(signal, "pthread_sigmask"):  # on Windows, where a Ctrl-C in the block is lost
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, handler)
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # children inherit it
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def processors() -> int:
    """Returns the number of processors that the current process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
