"""Standard output and standard error of the program, which may be closed, full or without a reader.

A failure of standard output is no failure of a file or a connection: `except OSError` around the
work of a command must not take one for the other. So it is an error of its own.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


class OutputError(Exception):
    """Standard output cannot be written; the message has the reason.

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
