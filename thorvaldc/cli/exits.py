"""Exit statuses, and the conversion of expected exceptions to one line and a status."""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

# 1: errors in the input.  2: usage.  3: a failure outside of thorvaldc, such as a disk, a display
# or a bus.  70: an error in thorvaldc.
DONE, INPUT, USAGE, OUTSIDE, INTERNAL = 0, 1, 2, 3, 70
INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143

TRACEBACK_VARIABLE = "THORVALDC_TRACEBACK"


class OutsideError(Exception):
    """A disk, a display, a bus or an installation failed; the message is one line."""


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived while the process has files or devices to close."""


@contextmanager
def closing_when_terminated() -> Iterator[None]:
    """Handles SIGTERM like Ctrl-C within the block, so that open files are closed."""

    def end(number: int, frame: FrameType | None) -> None:
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous_handler = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous_handler)


def protect(work: Callable[[], int]) -> int:
    """Calls ``work``; converts each expected exception to one line on stderr and a status."""
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
        # The reader of our output is gone: print nothing, here and at the end of the interpreter.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return BROKEN_PIPE
    except OutsideError as error:
        return _fail(f"error: {error}", OUTSIDE)
    except OSError as error:
        return _fail(f"error: {_one_line(error)}", OUTSIDE)
    except Exception:
        # A package that is interrupted during its import may raise another exception instead.
        if interrupts.occurred:
            return _interrupted()
        raise


class _Interrupts:
    """A handler of SIGINT that does what Python does and remembers the signal."""

    def __init__(self) -> None:
        self.occurred = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.occurred = True
        signal.default_int_handler(number, frame)


def _watch_interrupts() -> _Interrupts:
    present_handler = signal.getsignal(signal.SIGINT)
    if isinstance(present_handler, _Interrupts):
        return present_handler
    interrupts = _Interrupts()
    if present_handler is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupts)
    return interrupts


def _interrupted() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C finds the process ending
    # CPython remembers a KeyboardInterrupt that passed through code made from text, such as
    # dataclasses, and ends the process by the signal instead of our status.  Any other code made
    # from text clears this.
    exec("pass")
    return _fail("interrupted", INTERRUPTED)


def _fail(line: str, status: int) -> int:
    show_traceback()
    print(line, file=sys.stderr)
    return status


def show_traceback() -> None:
    """Prints the traceback if the environment variable requests it."""
    if os.environ.get(TRACEBACK_VARIABLE):
        traceback.print_exc()


def _one_line(error: OSError) -> str:
    name = f"{error.filename}: " if error.filename is not None else ""
    return f"{name}{error.strerror or error}"
