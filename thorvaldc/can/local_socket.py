"""Local (Unix domain) sockets of a robot's programs: where they are, and messages over them."""

from __future__ import annotations

import json
import os
import socket
import stat
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LONGEST_PATH = 100
"""Longest path of a socket, in bytes, that every system accepts (Linux: 107, macOS: 103)."""

# -- paths -----------------------------------------------------------------------------------


def socket_path(name: str) -> Path:
    """Returns the path of a socket: ``name`` itself where it contains a slash, otherwise a file
    of that name in the user's own runtime directory.

    Raises ``OSError`` where the path is too long for a socket, or the directory belongs to another
    user.
    """
    path = Path(name) if "/" in name else runtime_directory() / f"{name}.sock"
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise OSError(f"the path of the socket {path} is longer than {LONGEST_PATH} bytes")
    return path


def remove_stale_socket(path: Path, program: str) -> None:
    """Removes the socket that a killed process has left at ``path``.

    Raises ``OSError`` where ``program`` still answers there, and where the path is not a socket.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise OSError(f"{path} is not a socket; it was not removed")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink()
        else:
            raise OSError(f"{program} already runs at {path}")


def runtime_directory() -> Path:
    """Returns the directory of the user's sockets and locks; creates it where it is missing.

    Raises ``PermissionError`` where another user owns it: under /tmp anybody could have made it.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        directory = Path(runtime) / "thorvaldc"
    else:
        directory = Path(tempfile.gettempdir()) / f"thorvaldc-{os.getuid()}"
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = directory.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise PermissionError(f"{directory} belongs to another user")
    return directory


# -- messages --------------------------------------------------------------------------------
#
# A message is its body's length (u16, little endian), its kind (one byte) and its body.

_HEADER = struct.Struct("<Hc")


def pack(kind: bytes, body: bytes = b"") -> bytes:
    """Returns a message of the kind, a single byte."""
    return _HEADER.pack(len(body), kind) + body


def pack_json(kind: bytes, value: Any) -> bytes:
    """Returns a message whose body is ``value`` as JSON."""
    return pack(kind, json.dumps(value).encode())


class Unpacker:
    """Splits a stream of bytes into messages; keeps an incomplete message for the next call."""

    def __init__(self) -> None:
        self._incomplete = b""

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yields kind and body of each message that ``data`` completes."""
        data = self._incomplete + data
        start = 0
        while len(data) - start >= _HEADER.size:
            length, kind = _HEADER.unpack_from(data, start)
            end = start + _HEADER.size + length
            if end > len(data):
                break
            yield kind, data[start + _HEADER.size : end]
            start = end
        self._incomplete = data[start:]
