"""What a bus's server and its clients say to each other over a local socket.

A message is a length (u16, of what follows the kind), a kind (one letter) and a body,
little endian.  The client begins with HELLO, the server answers WELCOME or CLOSED.
"""

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

from thorvaldc.can.frame import CanFrame

VERSION = 1

# From the client: JSON (version, name, bitrate, ...), a frame to send, to wait until (ns),
# to come back from bus-off.
HELLO, SEND, WAIT, RESTART = b"H", b"S", b"W", b"A"
# From the server: JSON; a frame received; its own frame got through or was refused; the
# controller's state as JSON; the time (ns) that a wait ended; JSON with the reason of the end.
WELCOME, FRAME, SENT, REFUSED, STATE, TIME, CLOSED = b"w", b"F", b"D", b"R", b"s", b"T", b"C"

_HEADER = struct.Struct("<Hc")
_FRAME = struct.Struct("<qIBB")
_EXTENDED, _REMOTE, _OWN = 1, 2, 4
LONGEST_PATH = 100
"""Bytes of a socket's path that every system takes."""


def pack(kind: bytes, body: bytes = b"") -> bytes:
    return _HEADER.pack(len(body), kind) + body


def pack_json(kind: bytes, value: Any) -> bytes:
    return pack(kind, json.dumps(value).encode())


def pack_frame(kind: bytes, frame: CanFrame, time: int = 0, own: bool = False) -> bytes:
    flags = _EXTENDED * frame.extended | _REMOTE * frame.remote | _OWN * own
    return pack(kind, _FRAME.pack(time, frame.id, flags, frame.length) + frame.data)


def unpack_frame(body: bytes) -> tuple[int, CanFrame, bool]:
    """Time (ns), frame, and whether it is the client's own.  Raises ``ValueError``."""
    if len(body) < _FRAME.size:
        raise ValueError("a frame is cut off")
    time, identifier, flags, length = _FRAME.unpack_from(body)
    extended, remote = bool(flags & _EXTENDED), bool(flags & _REMOTE)
    data = body[_FRAME.size :]
    if length > 8 or identifier >> (29 if extended else 11) or len(data) != length * (not remote):
        raise ValueError("a frame is none of CAN's")
    frame = CanFrame(identifier, data, extended, remote, length if remote else 0)
    return time, frame, bool(flags & _OWN)


def pack_time(kind: bytes, time: int) -> bytes:
    return pack(kind, struct.pack("<q", time))


def unpack_time(body: bytes) -> int:
    """Raises ``ValueError``."""
    if len(body) != 8:
        raise ValueError("a time is cut off")
    found: int = struct.unpack("<q", body)[0]
    return found


class Unpacker:
    """Messages out of a stream of bytes."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Take what has come; gives each message that is whole as kind and body."""
        data = self._rest + data
        at = 0
        while len(data) - at >= _HEADER.size:
            length, kind = _HEADER.unpack_from(data, at)
            end = at + _HEADER.size + length
            if end > len(data):
                break
            yield kind, data[at + _HEADER.size : end]
            at = end
        self._rest = data[at:]


def channel_path(channel: str) -> Path:
    """Where the socket of a channel is: a path as it stands, a name in the user's own folder.

    Raises ``OSError`` where the path is too long for a socket, or the folder belongs
    to somebody else.
    """
    path = Path(channel) if "/" in channel else _folder() / f"{channel}.sock"
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise OSError(f"the channel's socket {path} has more than {LONGEST_PATH} bytes")
    return path


def free_path(path: Path, what: str) -> None:
    """Make room for a socket: remove the one that a process that was killed has left.

    Raises ``OSError`` where ``what`` is run there, and where the path is no socket's.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise OSError(f"{path} is no socket, and is left as it is")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink()
        else:
            raise OSError(f"{what} is run at {path} already")


def _folder() -> Path:
    given = os.environ.get("XDG_RUNTIME_DIR")
    if given:
        folder = Path(given) / "thorvaldc"
    else:
        folder = Path(tempfile.gettempdir()) / f"thorvaldc-{os.getuid()}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise PermissionError(f"{folder} belongs to somebody else")
    return folder
