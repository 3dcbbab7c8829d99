"""Exit statuses, and the border that no expected fault crosses."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

# Exit status.  1 and 2 are the user's to mend, 3 the world's, 70 ours.
DONE, INPUT, USAGE, OUTSIDE, INTERNAL = 0, 1, 2, 3, 70
INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143

TRACEBACK_VARIABLE = "THORVALDC_TRACEBACK"


class OutsideError(Exception):
    """The world failed (a disk, a display, a bus); the message is one line for the user."""


class Terminated(KeyboardInterrupt):
    """The process was asked to end, and has something to close."""


@contextmanager
def closing_when_terminated() -> Iterator[None]:
    """Within the block a termination ends it as Ctrl-C does, so that what is open is closed."""

    def end(number: int, frame: FrameType | None) -> None:
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def protect(work: Callable[[], int]) -> int:
    """Run it; every way it can fail becomes one line on stderr and an exit status."""
    interrupts = _watch_interrupts()
    try:
        status = work()
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except Terminated:
        return _fail("terminated", TERMINATED)
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # Whoever read our output has left; say nothing, here and at the interpreter's end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return BROKEN_PIPE
    except OutsideError as fault:
        return _fail(f"error: {fault}", OUTSIDE)
    except OSError as fault:
        return _fail(f"error: {_one_line(fault)}", OUTSIDE)
    except Exception:
        # A package that is interrupted in its import may say that it is broken instead.
        if interrupts.seen:
            return _interrupted()
        raise


class _Interrupts:
    """Handles Ctrl-C as Python does, and remembers that there was one."""

    def __init__(self) -> None:
        self.seen = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        signal.default_int_handler(number, frame)


def _watch_interrupts() -> _Interrupts:
    now = signal.getsignal(signal.SIGINT)
    if isinstance(now, _Interrupts):
        return now
    interrupts = _Interrupts()
    if now is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupts)
    return interrupts


def _interrupted() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the second one would find us leaving
    # CPython remembers one that went through code made from text (dataclasses are), and would
    # end by the signal in place of our status; any other such code makes it forget.
    exec("pass")
    return _fail("interrupted", INTERRUPTED)


def _fail(line: str, status: int) -> int:
    show_traceback()
    print(line, file=sys.stderr)
    return status


def show_traceback() -> None:
    """Where it happened, for who asked by the environment variable."""
    if os.environ.get(TRACEBACK_VARIABLE):
        import traceback

        traceback.print_exc()


def _one_line(fault: OSError) -> str:
    name = f"{fault.filename}: " if fault.filename is not None else ""
    return f"{name}{fault.strerror or fault}"
