"""Reads input files of any kind with a limit on their size."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

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
