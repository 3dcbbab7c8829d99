"""Constants and basic messages of CANopen (CiA 301).

The CAN master, the commissioning and the simulated CANopen devices use these constants.

In CANopen the default COB-ID of a message is the base COB-ID of its service plus the node id (1 to
127).  The COB-ID 0x080 is used for SYNC, and the COB-IDs 0x081 to 0x0FF are used for EMCY messages.

    0x000  NMT            master -> nodes   command, node id (0: every node)
    0x080  SYNC           master -> nodes   no data
    0x080  EMCY     + id  node -> master    error code (u16), error register (u8), 5 bytes
    0x180  TPDO 1   + id  node -> master    0x280, 0x380, 0x480: TPDO 2, 3, 4
    0x200  RPDO 1   + id  master -> node    0x300, 0x400, 0x500: RPDO 2, 3, 4
    0x580  SDO      + id  node -> master    response
    0x600  SDO      + id  master -> node    request
    0x700  heartbeat + id node -> all       NMT state (bits 0 to 6)

The module ``thorvaldc.can.sdo`` encodes and decodes SDO messages.  The module ``thorvaldc.can.lss``
defines the constants of the layer setting services (LSS).  The module ``thorvaldc.can.cia402``
defines the constants of the drive profile CiA 402.
"""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

HIGHEST_NODE_ID = 127

# COB-IDs of NMT and SYNC, and bases of the COB-IDs of all other services.
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
    """NMT command, which is the first byte of an NMT message.

    The second byte of an NMT message is the node id; node id 0 addresses every node.
    """

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(enum.IntEnum):
    """NMT state that a node reports in its heartbeat."""

    INITIALISING = 0
    """Value of the boot-up message, which a node sends once after power-on or reset."""
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127

    @property
    def text(self) -> str:
        """Name of the NMT state in messages to the user, for example ``pre-operational``."""
        return "boot-up" if self is NmtState.INITIALISING else self.name.lower().replace("_", "-")


def nmt_message(command: NmtCommand, node_id: int) -> bytes:
    """Returns the data of an NMT message; ``node_id`` 0 addresses every node."""
    return bytes([command, node_id])


def heartbeat_state(data: bytes) -> int:
    """Returns the NMT state in the data of a heartbeat message.

    Bit 7 of the heartbeat byte is ignored, because the CANopen node guarding protocol uses bit 7 as
    a toggle bit.  The NMT state is returned as a number, because a device may report a state that
    ``NmtState`` does not define.  Raises ``IndexError`` if the heartbeat has no data bytes.
    """
    return data[0] & 0x7F


def nmt_state_text(state: int) -> str:
    """Returns the name of an NMT state, or the number in hexadecimal if CiA 301 has no name."""
    try:
        return NmtState(state).text
    except ValueError:
        return f"{state:#04x}"


# -- EMCY -------------------------------------------------------------------------------------

_EMERGENCY = struct.Struct("<HB5s")


class Emergency(NamedTuple):
    """An EMCY (emergency) message of a CANopen device.

    - ``error_code``: emergency error code; 0 means that the device has no error any more;
    - ``register``: error register (object 0x1001), ``None`` if the message is too short;
    - ``data``: up to 5 bytes that the manufacturer of the device defines.
    """

    error_code: int
    register: int | None = None
    data: bytes = b""

    @classmethod
    def unpack(cls, data: bytes) -> Emergency:
        """Decodes an EMCY message.

        Raises ``ValueError`` if the message is shorter than the error code (2 bytes).
        """
        if len(data) < 2:
            raise ValueError(f"an EMCY message has {len(data)} bytes, not 8")
        return cls(int.from_bytes(data[:2], "little"), data[2] if len(data) > 2 else None, data[3:])

    def pack(self) -> bytes:
        return _EMERGENCY.pack(self.error_code, self.register or 0, self.data)
