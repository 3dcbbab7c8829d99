"""Constants of CANopen (CiA 301) that the master, the commissioning and the simulation share.

Predefined connection set: a COB-ID is the base of a service plus the node id (1 to 127).
SYNC and EMCY have the same base: 0x080 itself is SYNC, 0x081 to 0x0FF are EMCY.

    0x000  NMT            master -> nodes   command, node id (0: every node)
    0x080  SYNC           master -> nodes   no data
    0x080  EMCY     + id  node -> master    error code (u16), error register (u8), 5 bytes
    0x180  TPDO 1   + id  node -> master    0x280, 0x380, 0x480: TPDO 2, 3, 4
    0x200  RPDO 1   + id  master -> node    0x300, 0x400, 0x500: RPDO 2, 3, 4
    0x580  SDO      + id  node -> master    response
    0x600  SDO      + id  master -> node    request
    0x700  heartbeat + id node -> all       NMT state (bits 0 to 6)
"""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

HIGHEST_NODE_ID = 127

# COB-IDs, and bases of COB-IDs.
NMT = 0x000
SYNC = 0x080
EMCY = 0x080
TIME_STAMP = 0x100
TPDO = (0x180, 0x280, 0x380, 0x480)
RPDO = (0x200, 0x300, 0x400, 0x500)
SDO_RESPONSE = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700


class NmtCommand(enum.IntEnum):
    """First byte of an NMT message; the second is the node id, 0 for every node."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(enum.IntEnum):
    """State of a node, as its heartbeat reports it."""

    INITIALISING = 0
    """Value of the boot-up message, which a node sends once after power-on or reset."""
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127

    @property
    def text(self) -> str:
        """For messages to the user: ``pre-operational``."""
        return "boot-up" if self is NmtState.INITIALISING else self.name.lower().replace("_", "-")


def nmt_message(command: NmtCommand, node_id: int) -> bytes:
    """Returns the data of an NMT message; ``node_id`` 0 addresses every node."""
    return bytes([command, node_id])


def heartbeat_state(data: bytes) -> int:
    """Returns the state byte of a heartbeat without its toggle bit, which node guarding uses.

    The result may be a value that ``NmtState`` does not define.  ``data`` must not be empty.
    """
    return data[0] & 0x7F


def nmt_state_text(state: int) -> str:
    """Returns the name of a state of a heartbeat, or its number where CiA 301 defines none."""
    try:
        return NmtState(state).text
    except ValueError:
        return f"{state:#04x}"


# -- SDO: the first byte of request and response --------------------------------------------
#
# An SDO message has 8 bytes: command, index (u16), subindex, and 4 bytes of data.  Bits 5 to 7
# of the command are the specifier.  Expedited transfer, up to 4 bytes in one frame each way:
#
#    upload    client   40 index sub 00 00 00 00
#              server   43 index sub data           4 bytes; 47: 3, 4B: 2, 4F: 1
#    download  client   23 index sub data           4 bytes; 27: 3, 2B: 2, 2F: 1
#              server   60 index sub 00 00 00 00
#    abort     either   80 index sub abort code (u32)
#
# Segmented transfer of longer values: the first response (41) or request (21) has the size (u32)
# in place of the data.  Then each segment of up to 7 bytes has its own request and response,
# whose command holds the toggle bit, the number of unused bytes and the "last segment" flag.


class ClientCommand(enum.IntEnum):
    """Bits 5 to 7 of a request, shifted to bit 0."""

    DOWNLOAD_SEGMENT = 0
    INITIATE_DOWNLOAD = 1
    INITIATE_UPLOAD = 2
    UPLOAD_SEGMENT = 3
    ABORT = 4


SDO_UPLOAD = ClientCommand.INITIATE_UPLOAD << 5
"""Request to read an object: 0x40."""
SDO_DOWNLOAD_RESPONSE = 0x60
SDO_ABORT = ClientCommand.ABORT << 5
"""First byte of an abort, from either side: 0x80."""
EXPEDITED, SIZE_INDICATED = 0x02, 0x01
"""Bits of the command of an initiate message: the data is in this message; its size is given."""
SDO_HEADER = struct.Struct("<BHB")
"""Command, index, subindex; 4 bytes of data follow."""


def sdo_upload(index: int, subindex: int) -> bytes:
    """Returns the request to read an object."""
    return SDO_HEADER.pack(SDO_UPLOAD, index, subindex) + bytes(4)


def sdo_abort(index: int, subindex: int, code: int) -> bytes:
    """Returns the message that aborts a transfer."""
    return SDO_HEADER.pack(SDO_ABORT, index, subindex) + struct.pack("<I", code)


def sdo_abort_code(data: bytes) -> int | None:
    """Returns the abort code of a message of 8 bytes; ``None`` where it is no abort."""
    if data[0] != SDO_ABORT:
        return None
    code: int = struct.unpack_from("<I", data, 4)[0]
    return code


class AbortCode(enum.IntEnum):
    """Reasons for which a transfer is aborted; a device may send others."""

    TOGGLE_NOT_ALTERNATED = 0x05030000
    TIMED_OUT = 0x05040000
    COMMAND_UNKNOWN = 0x05040001
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    OBJECT_UNKNOWN = 0x06020000
    NOT_MAPPABLE = 0x06040041
    MAPPING_TOO_LONG = 0x06040042
    LENGTH_WRONG = 0x06070010
    SUBINDEX_UNKNOWN = 0x06090011
    VALUE_RANGE = 0x06090030
    STORE_REFUSED = 0x08000020
    STATE_REFUSED = 0x08000022


_ABORT_TEXTS = {
    AbortCode.TOGGLE_NOT_ALTERNATED: "the toggle bit did not alternate",
    AbortCode.TIMED_OUT: "the SDO protocol timed out",
    AbortCode.COMMAND_UNKNOWN: "the command specifier is unknown",
    AbortCode.UNSUPPORTED_ACCESS: "this access is not supported",
    AbortCode.WRITE_ONLY: "the object is write-only",
    AbortCode.READ_ONLY: "the object is read-only",
    AbortCode.OBJECT_UNKNOWN: "the object does not exist",
    AbortCode.NOT_MAPPABLE: "the object cannot be mapped to a PDO",
    AbortCode.MAPPING_TOO_LONG: "the mapped objects are longer than a PDO",
    AbortCode.LENGTH_WRONG: "the data type does not match: wrong length",
    AbortCode.SUBINDEX_UNKNOWN: "the subindex does not exist",
    AbortCode.VALUE_RANGE: "the value is out of range",
    AbortCode.STORE_REFUSED: "the data cannot be stored",
    AbortCode.STATE_REFUSED: "the device state does not allow it",
}


def abort_text(code: int) -> str:
    """Returns the reason and the number of an abort code, for messages to the user."""
    reason = next((text for known, text in _ABORT_TEXTS.items() if known == code), "aborted")
    return f"{reason} (SDO abort {code:#010x})"


# -- EMCY -------------------------------------------------------------------------------------

_EMERGENCY = struct.Struct("<HB5s")


class Emergency(NamedTuple):
    """An EMCY message.  ``error_code`` 0: the device has no error any more.

    ``register`` is object 0x1001; ``None`` where the message is too short for it.  The meaning of
    ``data``, up to 5 bytes, is the manufacturer's.
    """

    error_code: int
    register: int | None = None
    data: bytes = b""

    @classmethod
    def unpack(cls, data: bytes) -> Emergency:
        """Raises ``ValueError`` where even the error code is missing."""
        if len(data) < 2:
            raise ValueError(f"an EMCY message has {len(data)} bytes, not 8")
        return cls(int.from_bytes(data[:2], "little"), data[2] if len(data) > 2 else None, data[3:])

    def pack(self) -> bytes:
        return _EMERGENCY.pack(self.error_code, self.register or 0, self.data)
