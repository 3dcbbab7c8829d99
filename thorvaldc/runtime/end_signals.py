"""The signals that end a run: the program stops the robot in order, and ends then."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator

END_SIGNALS = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if name in signal.Signals.__members__
)
"""All signals with which a person, a terminal that closes, or the system ends a program."""


@contextlib.contextmanager
def end_signals() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns true after one of the signals ``END_SIGNALS`` was received.

    Further signals change nothing, so that they do not cut off the stop of the robot, which belongs
    into the ``with`` block.  SIGHUP stays ignored where the program was started to outlive its
    terminal (``nohup``).  Outside the main thread no signal is received, because Python runs signal
    handlers only in the main thread.
    """
    received: list[int] = []
    previous = {}
    if threading.current_thread() is threading.main_thread():
        for number in END_SIGNALS:
            if number.name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN:
                continue
            previous[number] = signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
