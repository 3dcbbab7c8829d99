"""Exit statuses of the program, and the conversion of expected exceptions to an exit status."""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from thorvaldc.cli.standard_streams import OutputError, discard_output

# Exit status 1 means errors in the input, and 2 means wrong usage. Exit status 3 means a failure
# outside of thorvaldc, such as a full disk or a missing CAN bus. Exit status 70 means a bug in
# thorvaldc.
DONE, INPUT, USAGE, OUTSIDE, INTERNAL = 0, 1, 2, 3, 70
INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143

TRACEBACK_VARIABLE = "THORVALDC_TRACEBACK"


class OutsideError(Exception):
    """A failure of a disk, a display, a CAN bus or an installation, with a message on one line."""


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM, so that files and devices are closed before the process ends."""


@contextmanager
def closing_when_terminated() -> Iterator[None]:
    """Raises ``Terminated`` if the process receives SIGTERM within the block, so that open files
    are closed."""

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
    """Calls the function ``work`` and returns its exit status.

    If ``work`` raises an expected exception, one line is printed on stderr and an exit status is
    returned.
    """
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
    except OutputError as error:
        discard_output()
        return _fail(f"error: stdout: {error}", OUTSIDE) if error.has_reader else BROKEN_PIPE
    except OutsideError as error:
        return _fail(f"error: {error}", OUTSIDE)
    except OSError as error:
        return _fail(f"error: {_one_line(error)}", OUTSIDE)
    except Exception:
        # If Ctrl-C interrupts the import of a package, the package may raise another exception
        # instead of KeyboardInterrupt.
        if interrupts.occurred:
            return _interrupted()
        raise


class _Interrupts:
    """A signal handler for SIGINT that raises ``KeyboardInterrupt`` and remembers the signal."""

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
    # A second Ctrl-C is ignored while the process ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # CPython remembers a KeyboardInterrupt that propagated through code compiled from text, such as
    # the methods of dataclasses. After such a KeyboardInterrupt, CPython ends the process with the
    # signal SIGINT instead of the exit status. Executing other code from text makes CPython forget
    # the KeyboardInterrupt.
    exec("pass")
    return _fail("interrupted", INTERRUPTED)


def _fail(line: str, status: int) -> int:
    show_traceback()
    print(line, file=sys.stderr)
    return status


def show_traceback() -> None:
    """Prints the traceback of an exception if the environment variable ``THORVALDC_TRACEBACK`` is
    set."""
    if os.environ.get(TRACEBACK_VARIABLE):
        traceback.print_exc()


def _one_line(error: OSError) -> str:
    name = f"{error.filename}: " if error.filename is not None else ""
    return f"{name}{error.strerror or error}"
