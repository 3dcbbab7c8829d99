"""Paths and message format of the local (Unix domain) sockets between a robot's programs."""

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
    """Returns the path of the local socket with the given name.

    A socket name that contains a slash is used as the path.  The socket of a name without a slash
    is the file ``name.sock`` in the runtime directory of the user.

    Raises ``OSError`` if the path is too long for a socket, or if the runtime directory belongs to
    another user.
    """
    path = Path(name) if "/" in name else runtime_directory() / f"{name}.sock"
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise OSError(f"the path of the socket {path} is longer than {LONGEST_PATH} bytes")
    return path


def remove_stale_socket(path: Path, program: str) -> None:
    """Removes the socket file at ``path`` if the process that created the socket has been killed.

    ``program``: name of the program, for the error message.  Raises ``OSError`` if a program still
    accepts connections at ``path``, or if ``path`` is not a socket.
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


def listen(path: Path, program: str) -> socket.socket:
    """Returns a listening local socket at ``path``, which only this user can open.

    ``program``: name of the program that listens, for the error message.  Raises ``OSError`` if a
    program already listens at ``path``, or if the socket cannot be created.
    """
    remove_stale_socket(path, program)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    mask = os.umask(0o177)
    try:
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise OSError(f"{path}: {error.strerror or error}") from None
    finally:
        os.umask(mask)
    listener.listen()
    listener.setblocking(False)
    return listener


def runtime_directory() -> Path:
    """Returns the directory for the user's local sockets and lock files.

    Creates the directory of the sockets if the directory does not exist.

    Raises ``PermissionError`` if the directory of the sockets belongs to another user or is a
    symbolic link, because every user can create both in /tmp.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        directory = Path(runtime) / "thorvaldc"
    else:
        directory = Path(tempfile.gettempdir()) / f"thorvaldc-{os.getuid()}"
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = directory.lstat()
    if stat.S_ISLNK(status.st_mode):
        raise PermissionError(f"{directory} is a symbolic link; a directory is needed")
    if status.st_uid != os.getuid():
        raise PermissionError(f"{directory} belongs to another user")
    return directory


# -- messages --------------------------------------------------------------------------------
#
# A message consists of the length of the body (u16, little endian), the kind of message (one byte)
# and the body.

_HEADER = struct.Struct("<Hc")


def pack(kind: bytes, body: bytes = b"") -> bytes:
    """Returns a message for the local socket as bytes.

    ``kind``: one byte that identifies the type of the message.
    """
    return _HEADER.pack(len(body), kind) + body


def pack_json(kind: bytes, value: Any) -> bytes:
    """Returns a message as bytes, with ``value`` encoded as JSON in the message body."""
    return pack(kind, json.dumps(value).encode())


class Unpacker:
    """Splits a byte stream into messages.

    The bytes of an incomplete message are kept until the rest of the message arrives.
    """

    def __init__(self) -> None:
        self._incomplete = b""

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Appends ``data`` to the byte stream.

        Yields the message type and the message body of each complete message.
        """
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
