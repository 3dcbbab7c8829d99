"""Messages between the server of a simulated bus and its clients, over a local socket.

The module ``local_socket`` defines the framing of the messages.  All numbers are little endian.
The first message of a client is HELLO.  The server answers with WELCOME, or with CLOSED and the
reason for the refusal.  After WELCOME the client and the server may send messages at any time:

    client                          server
    HELLO  version, name, ... --->
                              <---  WELCOME  bitrate, present time, ...
    SEND   frame              --->
                              <---  SENT     the frame won arbitration and was acknowledged,
                                    REFUSED  or it was not queued
                              <---  FRAME    a frame of another node
                              <---  STATE    the controller's error state has changed
    RESTART                   --->           recover from bus-off
    WAIT   until (ns)         --->           lockstep only: simulated time may pass
                              <---  TIME     present time (ns): a frame has come, or time is up
                              <---  CLOSED   reason
"""

from __future__ import annotations

import struct

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.local_socket import pack

VERSION = 1

# Kinds of messages from client to server.  The body of HELLO is JSON; the body of WAIT is a time
# (ns).
HELLO, SEND, WAIT, RESTART = b"H", b"S", b"W", b"A"
# Kinds of messages from server to client.  The bodies of WELCOME, STATE and CLOSED are JSON; the
# body of TIME is a time (ns).
WELCOME, FRAME, SENT, REFUSED, STATE, TIME, CLOSED = b"w", b"F", b"D", b"R", b"s", b"T", b"C"

_FRAME = struct.Struct("<qIBB")
"""Header of a CAN frame: time (ns), identifier, flags, data length code; the data follows."""
_EXTENDED, _REMOTE, _OWN = 1, 2, 4
_TIME = struct.Struct("<q")


def pack_frame(kind: bytes, frame: CanFrame, time: int = 0, own: bool = False) -> bytes:
    """Returns a SEND or FRAME message with a CAN frame.

    - ``time``: time (ns) at which the frame was complete, for FRAME only;
    - ``own``: ``True`` if the receiving client has sent the frame itself.
    """
    flags = _EXTENDED * frame.extended | _REMOTE * frame.remote | _OWN * own
    return pack(kind, _FRAME.pack(time, frame.id, flags, frame.length) + frame.data)


def unpack_frame(body: bytes) -> tuple[int, CanFrame, bool]:
    """Decodes the body of a SEND or FRAME message.

    Returns the time (ns), the CAN frame, and ``True`` if the client has sent the frame itself.
    Raises ``ValueError`` if the body is not a valid CAN frame.
    """
    if len(body) < _FRAME.size:
        raise ValueError("a frame is incomplete")
    time, identifier, flags, length = _FRAME.unpack_from(body)
    extended, remote = bool(flags & _EXTENDED), bool(flags & _REMOTE)
    data = body[_FRAME.size :]
    if length > 8 or identifier >> (29 if extended else 11) or len(data) != length * (not remote):
        raise ValueError("a frame is not a valid CAN frame")
    frame = CanFrame(identifier, data, extended, remote, length if remote else 0)
    return time, frame, bool(flags & _OWN)


def pack_time(kind: bytes, time: int) -> bytes:
    return pack(kind, _TIME.pack(time))


def unpack_time(body: bytes) -> int:
    """Decodes the body of a WAIT or TIME message and returns the time (ns).

    Raises ``ValueError`` if the body does not have 8 bytes.
    """
    if len(body) != _TIME.size:
        raise ValueError("a time is incomplete")
    time: int = _TIME.unpack(body)[0]
    return time
