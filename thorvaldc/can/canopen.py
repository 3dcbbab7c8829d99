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

``sdo`` has the SDO messages, ``lss`` the layer setting services, ``cia402`` the drive profile.
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
