"""SDO messages of a client and a server (CiA 301, 7.2.4), for values of every length.

``canopen`` draws the expedited transfer.  A longer value goes in segments of up to 7 bytes:

    client                                   server
    40 index sub 00 00 00 00  ----------->
                              <-----------   41 index sub size (u32)
    60 00 00 00 00 00 00 00   ----------->                                  toggle 0
                              <-----------   00 seven bytes
    70 00 00 00 00 00 00 00   ----------->                                  toggle 1
                              <-----------   1B two bytes                   5 unused, last segment

Byte 0 of a segment: bit 4 toggle, bits 3 to 1 number of unused bytes, bit 0 last segment.
"""

from __future__ import annotations

from thorvaldc.can.canopen import (
    EXPEDITED,
    SDO_HEADER,
    SIZE_INDICATED,
    ClientCommand,
)
from thorvaldc.model.bus import OBJECT_TYPES

SEGMENT_LENGTH = 7
"""Bytes of data in a segment."""
_UPLOAD_RESPONSE = 0x40
_TOGGLE_BIT, _LAST_SEGMENT = 4, 0x01


def number_length(type_name: str) -> int:
    """Returns the length (bytes) of a number with a type of CiA 301 (``unsigned16``)."""
    return max(OBJECT_TYPES[type_name][1] // 8, 1)


def encode_number(type_name: str, value: int) -> bytes:
    """Returns a number as an SDO transfers it: little-endian, negative ones as complement."""
    length = number_length(type_name)
    return (value & (1 << 8 * length) - 1).to_bytes(length, "little")


def decode_number(type_name: str, data: bytes) -> int:
    """Returns the number in the first bytes of ``data``; missing bytes count as 0."""
    length = number_length(type_name)
    signed = type_name.startswith("integer")
    return int.from_bytes(data[:length].ljust(length, b"\0"), "little", signed=signed)


# -- client ------------------------------------------------------------------------------------


def download_request(index: int, subindex: int, data: bytes) -> bytes:
    """Returns the expedited request to write 1 to 4 bytes."""
    command = ClientCommand.INITIATE_DOWNLOAD << 5 | _expedited(data)
    return SDO_HEADER.pack(command, index, subindex) + data.ljust(4, b"\0")


def upload_segment_request(toggle: int) -> bytes:
    """Returns the request for the next segment; ``toggle`` is 0 for the first one."""
    return bytes([ClientCommand.UPLOAD_SEGMENT << 5 | toggle << _TOGGLE_BIT]) + bytes(7)


def is_expedited(response: bytes) -> bool:
    """Whether the response to an upload request contains the value itself."""
    return bool(response[0] & EXPEDITED)


def expedited_data(message: bytes) -> bytes:
    """Returns the value in an expedited message; all 4 bytes where it states no size."""
    unused = message[0] >> 2 & 3 if message[0] & SIZE_INDICATED else 0
    return message[4 : 8 - unused]


# -- both --------------------------------------------------------------------------------------


def segment_data(message: bytes) -> bytes:
    """Returns the data of a segment."""
    return message[1 : 8 - (message[0] >> 1 & 7)]


def segment_toggle(message: bytes) -> int:
    return message[0] >> _TOGGLE_BIT & 1


def is_last_segment(message: bytes) -> bool:
    return bool(message[0] & _LAST_SEGMENT)


def _expedited(data: bytes) -> int:
    return (4 - len(data)) << 2 | EXPEDITED | SIZE_INDICATED


# -- server ------------------------------------------------------------------------------------


def upload_response(index: int, subindex: int, value: bytes) -> bytes:
    """Returns the response to an upload request: expedited for 1 to 4 bytes, else the size."""
    if 1 <= len(value) <= 4:
        command = _UPLOAD_RESPONSE | _expedited(value)
        return SDO_HEADER.pack(command, index, subindex) + value.ljust(4, b"\0")
    command = _UPLOAD_RESPONSE | SIZE_INDICATED
    return SDO_HEADER.pack(command, index, subindex) + len(value).to_bytes(4, "little")


def upload_segment_response(toggle: int, data: bytes, last: bool) -> bytes:
    """Returns a segment of up to 7 bytes."""
    command = toggle << _TOGGLE_BIT | (SEGMENT_LENGTH - len(data)) << 1 | int(last)
    return bytes([command]) + data.ljust(SEGMENT_LENGTH, b"\0")


def download_segment_response(toggle: int) -> bytes:
    """Returns the confirmation of a segment written by the client."""
    return bytes([0x20 | toggle << _TOGGLE_BIT]) + bytes(7)
