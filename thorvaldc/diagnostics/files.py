"""Reads files of others with limits, and writes files so that a full disk, Ctrl-C or a killed
process leaves no half file under their name.

A file is written under a hidden name beside it, and then gets its name in one step::

    page.html             <- old page      page.html  <- new page
    .thorvaldc-812-7f3a   <- new page ==>

A path that is no regular file, such as ``/dev/stdout`` or a pipe, is written directly.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import signal
import stat
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

MAX_LOG_BYTES = 256_000_000
"""Limit of recorded runs and other logs."""

_KINDS = {
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


def check_regular(status: os.stat_result) -> None:
    """Raises ``OSError`` if a file is not a regular file.

    Reading from a pipe can wait for ever, and a device can contain any number of bytes.

    - ``status``: result of ``os.stat`` for the file.
    """
    kind = stat.S_IFMT(status.st_mode)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind != stat.S_IFREG:
        name = _KINDS.get(kind, "not a file")
        raise OSError(errno.EINVAL, f"it is {name}; expected a regular file")


def read_bounded(path: Path | str, limit: int, *, cut: bool = False) -> bytes:
    """Returns the content of a regular file with at most ``limit`` bytes.

    Raises ``OSError`` if the file cannot be read, is not a regular file, or is larger.

    - ``cut``: whether the first ``limit`` bytes of a larger file are returned.
    """
    check_regular(os.stat(path))  # opening some devices has effects
    # Between the two checks, another program could replace the file by a pipe.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(path, flags), "rb") as file:
        check_regular(os.fstat(file.fileno()))
        # A limit far above the size of the file would reserve the memory of the limit.
        size = min(limit, os.fstat(file.fileno()).st_size)
        parts = [file.read(size)]
        rest = limit - size
        while rest > 0 and (part := file.read(min(rest, 1 << 20))):
            parts.append(part)  # the file grew, or its size is not known as in /proc
            rest -= len(part)
        if not cut and file.read(1):
            text = f"it has more than {limit / 1e6:g} MB, which is the limit"
            raise OSError(errno.EFBIG, text)
    return b"".join(parts)


def read_json(text: str | bytes) -> Any:
    """Returns the value of a JSON text.

    Raises ``ValueError`` if the text is not JSON, also for brackets that are nested deeper than
    Python can read, for which the module ``json`` raises ``RecursionError``.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None


STAGE_PREFIX = ".thorvaldc-"
"""Start of the names of files and folders that exist only while something is written."""
INCOMPLETE = ".incomplete"
"""End of the name of a file that could not be written to its end."""


def finite(value: Any) -> Any:
    """Replace infinities and NaN by ``None`` in nested dictionaries, lists and tuples.

    JSON can express neither infinities nor NaN.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value


def write_file(path: Path, content: str | bytes, *, new: bool = False) -> None:
    """Writes a whole file, text in UTF-8, or leaves the file as it was.

    Raises ``OSError`` with the name of the file, and ``FileExistsError`` if the file must be new
    and exists.
    """
    data = content.encode() if isinstance(content, str) else content
    with AtomicFile(path, new=new) as file:
        file.write_bytes(data)


def append_whole(descriptor: int, data: bytes, *, sync: bool = False) -> None:
    """Appends bytes to an open file, all or none: if the disk is full or Ctrl-C comes in between,
    the file is cut back to its old size.

    ``sync``: returns when the bytes are stored on the disk.  Raises ``OSError``.
    """
    size = os.fstat(descriptor).st_size
    try:
        while data:
            data = data[os.write(descriptor, data) :]
        if sync:
            os.fsync(descriptor)
    except BaseException:
        with contextlib.suppress(OSError):
            os.ftruncate(descriptor, size)
        raise


@contextlib.contextmanager
def errors_with_name(path: Path) -> Iterator[None]:
    """Adds the file name ``path`` to each ``OSError`` that the ``with`` block raises.

    An ``OSError`` from ``write`` or ``close``, for example on a full disk, has no file name.
    """
    try:
        yield
    except OSError as error:
        number = error.errno or 0
        raise OSError(number, error.strerror or os.strerror(number), str(path)) from None


class AtomicFile:
    """An open file that replaces another file in one step when it is closed.

    After an error of ``write``, ``close`` does not replace the file.  As a context manager, the
    file is also not replaced after an exception in the block.

    - ``new``: the file must not exist.
    - ``keep_incomplete``: what could be written is kept as ``<path>.incomplete`` after an error.
    """

    def __init__(self, path: Path, *, new: bool = False, keep_incomplete: bool = False) -> None:
        """Opens the hidden file.  Raises ``OSError`` with the name of the file."""
        self.path = path
        self._target = Path(os.path.realpath(path))
        self._new = new
        self._keep_incomplete = keep_incomplete
        self._failed = self._closed = False
        self._stage: Path | None = None
        with errors_with_name(path):
            old = _status(self._target)
            if new and os.path.lexists(path):
                raise OSError(errno.EEXIST, os.strerror(errno.EEXIST))
            if old is not None and stat.S_ISDIR(old.st_mode):
                raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
            opened, flags = self._target, os.O_WRONLY
            if old is None or stat.S_ISREG(old.st_mode):
                if old is not None and not os.access(self._target, os.W_OK):
                    raise OSError(errno.EACCES, os.strerror(errno.EACCES))
                name = f"{STAGE_PREFIX}{os.getpid()}-{os.urandom(4).hex()}"
                self._stage = opened = self._target.with_name(name)
                flags |= os.O_CREAT | os.O_EXCL
            flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
            self._file: Any = os.fdopen(os.open(opened, flags, 0o666), "wb")
            if old is not None and self._stage is not None:
                with contextlib.suppress(OSError):
                    os.chmod(self._stage, stat.S_IMODE(old.st_mode))
                    keep_owner(self._stage, self._target)

    def write(self, text: str) -> None:
        """Writes text in UTF-8."""
        self.write_bytes(text.encode())

    def write_bytes(self, data: bytes) -> None:
        with self._failing():
            self._file.write(data)

    def flush(self) -> None:
        """Passes what was written on to the operating system."""
        with self._failing():
            self._file.flush()

    def close(self) -> None:
        """Gives the file its name, if all was written.  A second call has no effect."""
        if self._closed:
            return
        try:
            if not self._failed:
                with self._failing():
                    self._file.close()
                    self._give_name()
        finally:
            if self._failed and self._keep_incomplete and self._stage is not None:
                with contextlib.suppress(OSError):
                    self._file.close()
                with contextlib.suppress(OSError):
                    os.replace(self._stage, f"{self._target}{INCOMPLETE}")
            self.discard()

    def discard(self) -> None:
        """Closes the file and leaves the old one in place."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._file.close()
        if self._stage is not None:
            with contextlib.suppress(OSError):
                self._stage.unlink(missing_ok=True)

    def _give_name(self) -> None:
        if self._stage is None:
            return
        if not self._new:
            os.replace(self._stage, self._target)
            return
        try:
            os.link(self._stage, self._target)
        except FileExistsError:
            raise
        except OSError:  # a file system without hard links
            if os.path.lexists(self._target):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from None
            os.replace(self._stage, self._target)

    def __enter__(self) -> AtomicFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self.discard()

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        with errors_with_name(self.path):
            try:
                yield
            except OSError:
                self._failed = True
                raise


def keep_owner(new: Path, old: Path) -> None:
    """Gives a new file or folder to the owner of the old one.

    Only the superuser can do that; files of other users belong to them anyway.
    """
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        owner = os.stat(old)
        os.chown(new, owner.st_uid, owner.st_gid, follow_symlinks=False)


def _status(path: Path) -> os.stat_result | None:
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


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
