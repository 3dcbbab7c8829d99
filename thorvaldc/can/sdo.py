"""SDO messages (CiA 301), with which a client reads and writes the object dictionary of a node.

An SDO message has 8 bytes: the command byte, the index of the object (2 bytes), the subindex of the
object, and 4 data bytes.  Bits 5 to 7 of the SDO command byte are the command specifier.  An
expedited SDO transfer moves a value of up to 4 bytes with one request and one response:

    upload    client   40 index sub 00 00 00 00
              server   43 index sub data           4 bytes; 47: 3, 4B: 2, 4F: 1
    download  client   23 index sub data           4 bytes; 27: 3, 2B: 2, 2F: 1
              server   60 index sub 00 00 00 00
    abort     either   80 index sub abort code (u32)

A segmented SDO transfer moves a value of more than 4 bytes in segments of up to 7 bytes:

    client                                   server
    40 index sub 00 00 00 00  ----------->
                              <-----------   41 index sub size (u32)
    60 00 00 00 00 00 00 00   ----------->                                  toggle 0
                              <-----------   00 seven bytes
    70 00 00 00 00 00 00 00   ----------->                                  toggle 1
                              <-----------   1B two bytes                   5 unused, last segment

Byte 0 of an SDO segment contains the toggle bit (bit 4), the number of unused bytes (bits 3 to 1),
and a flag for the last segment (bit 0).
"""

from __future__ import annotations

import enum
import struct

from thorvaldc.model.bus import OBJECT_TYPES

SEGMENT_LENGTH = 7
"""Largest number of data bytes in a segment."""
HEADER = struct.Struct("<BHB")
"""First 4 bytes of an SDO message: command, index, subindex."""
EXPEDITED, SIZE_INDICATED = 0x02, 0x01
"""Bits of the command byte: the message contains the data; the message states the data size."""
_TOGGLE_BIT, _LAST_SEGMENT = 4, 0x01
_UPLOAD_RESPONSE, _DOWNLOAD_RESPONSE = 0x40, 0x60


class ClientCommand(enum.IntEnum):
    """Command specifier of an SDO request: bits 5 to 7 of the command byte, as a number."""

    DOWNLOAD_SEGMENT = 0
    INITIATE_DOWNLOAD = 1
    INITIATE_UPLOAD = 2
    UPLOAD_SEGMENT = 3
    ABORT = 4


_ABORT = ClientCommand.ABORT << 5
"""Command byte of an abort message (0x80), for client and server."""

# -- numbers -----------------------------------------------------------------------------------


def number_length(type_name: str) -> int:
    """Returns the length (bytes) of a CiA 301 number type, such as ``unsigned16``."""
    return max(OBJECT_TYPES[type_name][1] // 8, 1)


def encode_number(type_name: str, value: int) -> bytes:
    """Returns an integer as little-endian bytes.

    Negative integers are encoded in two's complement.
    """
    length = number_length(type_name)
    return (value & (1 << 8 * length) - 1).to_bytes(length, "little")


def decode_number(type_name: str, data: bytes) -> int:
    """Returns the integer in the first bytes of ``data`` (little endian).

    Missing bytes of the integer are read as 0.
    """
    length = number_length(type_name)
    signed = type_name.startswith("integer")
    return int.from_bytes(data[:length].ljust(length, b"\0"), "little", signed=signed)


# -- client ------------------------------------------------------------------------------------


def upload_request(index: int, subindex: int) -> bytes:
    """Returns the SDO request to read an object of a node."""
    return HEADER.pack(ClientCommand.INITIATE_UPLOAD << 5, index, subindex) + bytes(4)


def download_request(index: int, subindex: int, data: bytes) -> bytes:
    """Returns the SDO request to write 1 to 4 bytes to an object of a node."""
    command = ClientCommand.INITIATE_DOWNLOAD << 5 | _expedited(data)
    return HEADER.pack(command, index, subindex) + data.ljust(4, b"\0")


def upload_segment_request(toggle: int) -> bytes:
    """Returns the SDO request for the next segment of an upload.

    ``toggle``: toggle bit, which is 0 for the first segment of an SDO transfer and changes with
    each segment.
    """
    return bytes([ClientCommand.UPLOAD_SEGMENT << 5 | toggle << _TOGGLE_BIT]) + bytes(7)


def segmented_download_request(index: int, subindex: int, length: int) -> bytes:
    """Returns the SDO request to write a value of ``length`` bytes in segments."""
    command = ClientCommand.INITIATE_DOWNLOAD << 5 | SIZE_INDICATED
    return HEADER.pack(command, index, subindex) + length.to_bytes(4, "little")


def last_download_segment_request(toggle: int, data: bytes) -> bytes:
    """Returns the SDO request with the last segment of a download, up to 7 bytes."""
    command = ClientCommand.DOWNLOAD_SEGMENT << 5 | toggle << _TOGGLE_BIT
    command |= (SEGMENT_LENGTH - len(data)) << 1 | _LAST_SEGMENT
    return bytes([command]) + data.ljust(SEGMENT_LENGTH, b"\0")


def is_expedited(response: bytes) -> bool:
    """Returns ``True`` if an SDO upload response contains the value of the object."""
    return bool(response[0] & EXPEDITED)


def expedited_data(message: bytes) -> bytes:
    """Returns the value of the object in an expedited SDO message, as bytes.

    If the SDO message does not state the data size, all 4 data bytes are returned.
    """
    unused = message[0] >> 2 & 3 if message[0] & SIZE_INDICATED else 0
    return message[4 : 8 - unused]


# -- both --------------------------------------------------------------------------------------


def segment_data(message: bytes) -> bytes:
    """Returns the data bytes of an SDO segment."""
    return message[1 : 8 - (message[0] >> 1 & 7)]


def segment_toggle(message: bytes) -> int:
    return message[0] >> _TOGGLE_BIT & 1


def is_last_segment(message: bytes) -> bool:
    return bool(message[0] & _LAST_SEGMENT)


def _expedited(data: bytes) -> int:
    return (4 - len(data)) << 2 | EXPEDITED | SIZE_INDICATED


def abort_message(index: int, subindex: int, code: int) -> bytes:
    """Returns the message that aborts an SDO transfer."""
    return HEADER.pack(_ABORT, index, subindex) + struct.pack("<I", code)


def abort_code(message: bytes) -> int | None:
    """Returns the abort code of an SDO message, or ``None`` if it is not an abort message."""
    if message[0] != _ABORT:
        return None
    code: int = struct.unpack_from("<I", message, 4)[0]
    return code


# -- server ------------------------------------------------------------------------------------


def download_response(index: int, subindex: int) -> bytes:
    """Returns the response of an SDO server to a download request."""
    return HEADER.pack(_DOWNLOAD_RESPONSE, index, subindex) + bytes(4)


def upload_response(index: int, subindex: int, value: bytes, segmented: bool = False) -> bytes:
    """Returns the response of an SDO server to an upload request.

    The SDO response contains an object value of 1 to 4 bytes.  If the object value has another
    length, or if ``segmented`` is ``True``, the SDO response contains only the number of bytes, and
    the value is sent in segments.
    """
    if 1 <= len(value) <= 4 and not segmented:
        command = _UPLOAD_RESPONSE | _expedited(value)
        return HEADER.pack(command, index, subindex) + value.ljust(4, b"\0")
    command = _UPLOAD_RESPONSE | SIZE_INDICATED
    return HEADER.pack(command, index, subindex) + len(value).to_bytes(4, "little")


def upload_segment_response(toggle: int, data: bytes, last: bool) -> bytes:
    """Returns an SDO upload segment with up to 7 data bytes."""
    command = toggle << _TOGGLE_BIT | (SEGMENT_LENGTH - len(data)) << 1 | int(last)
    return bytes([command]) + data.ljust(SEGMENT_LENGTH, b"\0")


def download_segment_response(toggle: int) -> bytes:
    """Returns the response of an SDO server to a download segment."""
    return bytes([0x20 | toggle << _TOGGLE_BIT]) + bytes(7)


# -- abort codes -------------------------------------------------------------------------------


class AbortCode(enum.IntEnum):
    """SDO abort codes of CiA 301 that this package sends or explains.

    A device may send SDO abort codes that this table does not contain.  ``text`` is the
    meaning of a code.
    """

    text: str

    def __new__(cls, code: int, text: str) -> AbortCode:
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member

    TOGGLE_NOT_ALTERNATED = 0x05030000, "the toggle bit did not alternate"
    TIMED_OUT = 0x05040000, "the SDO protocol timed out"
    COMMAND_UNKNOWN = 0x05040001, "the command specifier is unknown"
    CRC_WRONG = 0x05040004, "the checksum of a block transfer is wrong"
    UNSUPPORTED_ACCESS = 0x06010000, "this access is not supported"
    WRITE_ONLY = 0x06010001, "the object is write-only"
    READ_ONLY = 0x06010002, "the object is read-only"
    OBJECT_UNKNOWN = 0x06020000, "the object does not exist"
    NOT_MAPPABLE = 0x06040041, "the object cannot be mapped to a PDO"
    MAPPING_TOO_LONG = 0x06040042, "the mapped objects are longer than a PDO"
    PARAMETER_INCOMPATIBLE = 0x06040043, "the value contradicts another parameter"
    DEVICE_INCOMPATIBLE = 0x06040047, "the device is internally incompatible"
    HARDWARE_ERROR = 0x06060000, "a hardware error prevents the access"
    LENGTH_WRONG = 0x06070010, "the data type does not match: wrong length"
    TOO_LONG = 0x06070012, "the data type does not match: too many bytes"
    TOO_SHORT = 0x06070013, "the data type does not match: too few bytes"
    SUBINDEX_UNKNOWN = 0x06090011, "the subindex does not exist"
    VALUE_RANGE = 0x06090030, "the value is out of range"
    VALUE_TOO_HIGH = 0x06090031, "the value is too high"
    VALUE_TOO_LOW = 0x06090032, "the value is too low"
    GENERAL_ERROR = 0x08000000, "general error"
    STORE_REFUSED = 0x08000020, "the data cannot be stored"
    LOCAL_CONTROL = 0x08000021, "the device is under local control"
    STATE_REFUSED = 0x08000022, "the device state does not allow it"
    NO_DATA = 0x08000024, "no data available"


def abort_text(code: int) -> str:
    """Returns the meaning and the number of an SDO abort code, for messages to the user."""
    text = next((known.text for known in AbortCode if known == code), "aborted")
    return f"{text} (SDO abort {code:#010x})"
