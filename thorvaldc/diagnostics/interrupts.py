"""Delays the signals SIGINT and SIGTERM during a block of code."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Delays the signals SIGINT and SIGTERM until the end of a ``with`` block.

    A signal such as SIGINT is delayed only if it has a Python signal handler.  At the end of the
    ``with`` block, the handler of the first received signal runs.  Signals are not delayed outside
    the main thread, because Python runs signal handlers only in the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    all_handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in all_handlers.items() if callable(handler)}
    pending: list[int] = []
    for number in handlers:
        signal.signal(number, lambda number, _frame: pending.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if pending:
            handlers[signal.Signals(pending[0])](pending[0], None)
