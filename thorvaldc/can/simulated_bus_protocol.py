"""Messages between the server of a simulated bus and its clients, over a local socket.

The module ``thorvaldc.can.local_socket`` defines how messages are separated in the byte stream of
the socket.  All numbers in the messages are little endian.  A client first sends the message HELLO
to the server of the simulated bus.  The server answers HELLO with the message WELCOME, or refuses
the client with the message CLOSED and the reason.  Messages that client and server may send at any
time after WELCOME:

    client                          server
    HELLO  version, name, ... --->
                              <---  WELCOME  bitrate, present time, ...
    SEND   frame, time        --->
                              <---  SENT     the frame won arbitration and was acknowledged,
                                    REFUSED  or it was not queued
                              <---  FRAME    a frame of another node
                              <---  STATE    the controller's error state has changed
    RESTART                   --->           recover from bus-off
                              <---  TIME     present time (ns), every 5 ms
                              <---  CLOSED   reason

Client and server read the same clock: the time on the bus is the monotonic clock of the computer
minus ``start`` of WELCOME.  A SEND message contains the time at which the client has
sent the frame.  On a busy computer the process of the server may run late.  It then simulates each
frame at the time at which the client has sent it, so that the traffic on the bus is the same as if
the server had run in time.  Only the messages to the clients are late.  The newest TIME or FRAME
message tells a client up to which time it has received all frames of the bus:

    client   SEND a, 40 ms    SEND b, 60 ms
    server   (other processes run)            simulates a at 40 ms, b at 60 ms
    clock    |--------|--------|--------|--------|--->
             30       50       70       90 ms
"""

from __future__ import annotations

import struct

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.local_socket import pack

VERSION = 3

# Types of messages from a client to the server of a simulated bus.  The body of a HELLO message is
# JSON.
HELLO, SEND, RESTART = b"H", b"S", b"A"
# Types of messages from the server of a simulated bus to a client.  The bodies of WELCOME, STATE
# and CLOSED messages are JSON.  The body of a TIME message is a time (ns).
WELCOME, FRAME, SENT, REFUSED, STATE, TIME, CLOSED = b"w", b"F", b"D", b"R", b"s", b"T", b"C"

_FRAME = struct.Struct("<qIBB")
"""Header of a CAN frame: time (ns), identifier, flags, data length code; the data follows."""
_EXTENDED, _REMOTE, _OWN = 1, 2, 4
_TIME = struct.Struct("<q")


def pack_frame(kind: bytes, frame: CanFrame, time: int = 0, own: bool = False) -> bytes:
    """Returns a SEND or FRAME message with a CAN frame.

    - ``time``: time (ns) at which the frame was complete (FRAME) or sent by the client (SEND);
    - ``own``: ``True`` if the receiving client has sent the frame itself.
    """
    flags = _EXTENDED * frame.extended | _REMOTE * frame.remote | _OWN * own
    return pack(kind, _FRAME.pack(time, frame.id, flags, frame.length) + frame.data)


def unpack_frame(body: bytes) -> tuple[int, CanFrame, bool]:
    """Decodes the body of a SEND or FRAME message, which contains a CAN frame.

    Returns the time (ns), the CAN frame, and ``True`` if the receiving client has sent the CAN
    frame itself.  Raises ``ValueError`` if the message body is not a valid CAN frame.
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
    """Decodes the body of a TIME message and returns the time (ns).

    Raises ``ValueError`` if the message body does not have 8 bytes.
    """
    if len(body) != _TIME.size:
        raise ValueError("a time is incomplete")
    time: int = _TIME.unpack(body)[0]
    return time
