"""Exit statuses of the program, the conversion of expected exceptions to an exit status, and the
standard streams."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TextIO

from thorvaldc.diagnostics import OutsideError as OutsideError
from thorvaldc.tool_folders import PluginError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


# Exit status 1 means errors in the input, and 2 means wrong usage. Exit status 3 means a failure
# outside of thorvaldc, such as a full disk or a missing CAN bus. Exit status 70 means a bug in
# thorvaldc.
DONE, INPUT, USAGE, OUTSIDE, INTERNAL = 0, 1, 2, 3, 70
INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143

TRACEBACK_VARIABLE = "THORVALDC_TRACEBACK"


@contextmanager
def write_errors(path: str | Path) -> Iterator[None]:
    """Converts the exception for an unwritable file to ``OutsideError``."""
    try:
        yield
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror or error}") from None


# Both packages contain the same files, so a computer must not have both.
RUNTIME_ALONE = (
    "this installation is the runtime alone; to replace it: `pip uninstall thorvaldc-runtime`, then"
    " `pip install` with the path of the wheel or the checkout of thorvaldc"
)


def is_runtime_only() -> bool:
    """Returns whether only the package ``thorvaldc-runtime`` is installed, for the computer of a
    robot.

    It has the rooms ``runtime``, ``can``, ``commissioning``, ``model``, ``diagnostics`` and
    ``cli``, the target ``computer``, and the tools ``commission``, ``computer``, ``monitor``,
    ``service_calls`` and ``teleoperation``.
    """
    return find_spec("thorvaldc.compiler") is None


def check_full_installation(feature: str) -> None:
    """Raises ``OutsideError`` if only the runtime package is installed."""
    if is_runtime_only():
        raise OutsideError(f"{feature} is not available: {RUNTIME_ALONE}")


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
    except (OutsideError, PluginError) as error:
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


# -- standard streams, which may be closed, full or without a reader -----------------------


class OutputError(Exception):
    """Standard output cannot be written; the message has the reason.

    This is no ``OSError``: `except OSError` around the work of a command must not take it for a
    failure of a file or a connection.

    ``has_reader``: false if the program that reads the output has ended.
    """

    def __init__(self, error: OSError) -> None:
        super().__init__(error.strerror or str(error))
        self.has_reader = error.errno != errno.EPIPE


class _Output(io.RawIOBase):
    """Passes bytes on to the raw stream below a text stream."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream  # closes its file when nobody has it any more
        self._raw = getattr(stream.buffer, "raw", stream.buffer)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return int(self._raw.fileno())

    def isatty(self) -> bool:
        return bool(self._raw.isatty())

    def write(self, data: ReadableBuffer, /) -> int | None:
        try:
            written: int | None = self._raw.write(data)
        except OSError as error:
            return self._after_error(error, memoryview(data).nbytes)
        return written

    def _after_error(self, error: OSError, size: int) -> int:
        raise OutputError(error) from None


class _Messages(_Output):
    """Drops the messages that cannot be written: no result depends on them."""

    def _after_error(self, error: OSError, size: int) -> int:
        return size


def prepare_standard_streams() -> None:
    """Makes the standard streams usable, also closed ones.

    A closed descriptor becomes the null device, because the next opened file would get its number,
    and would get what libraries print. An error of stdout is an ``OutputError``. stderr raises no
    errors. A character that a terminal cannot show is escaped.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)  # gets the lowest free number
            os.set_inheritable(null, True)
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = _text_stream(_Output, 1, sys.stdout)
    sys.stderr = _text_stream(_Messages, 2, sys.stderr)


def discard_output() -> None:
    """Redirects stdout to the null device: Python's flush at exit would raise a second error."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)


def _text_stream(kind: type[_Output], descriptor: int, old: Any) -> TextIO:
    """Returns a text stream with the encoding and the buffering of another one, or a new one."""
    if old is None:
        old = open(descriptor, "w", closefd=False)  # noqa: SIM115
    # With PYTHONUNBUFFERED, Python has no buffer between the text stream and the raw stream.
    file: Any = kind(old)
    return io.TextIOWrapper(
        io.BufferedWriter(file) if hasattr(old.buffer, "raw") else file,
        encoding=old.encoding,
        errors="backslashreplace",
        line_buffering=old.line_buffering,
        write_through=old.write_through,
    )
