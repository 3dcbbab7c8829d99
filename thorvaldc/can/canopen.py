"""Constants and basic messages of CANopen (CiA 301), and of drives with the profile CiA 402.

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
    0x7E4  LSS            slave -> master   response
    0x7E5  LSS            master -> slaves  request

The module ``thorvaldc.can.sdo`` encodes and decodes SDO messages.  The module ``thorvaldc.can.lss``
defines the other constants of the layer setting services (LSS).
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
LSS_RESPONSE, LSS_REQUEST = 0x7E4, 0x7E5


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


# -- CiA 402 ----------------------------------------------------------------------------------

# The master writes the control word (object 0x6040) to change the power state of a drive, and reads
# it from the status word (object 0x6041).  Power states of a CiA 402 drive:
#
#     NOT_READY --> SWITCH_ON_DISABLED --shutdown--> READY_TO_SWITCH_ON --switch on--> SWITCHED_ON
#                         ^  ^                                                            |
#        fault reset      |  | disable voltage, from every state          enable operation |
#                         |  |                                                            v
#       FAULT ------------+  +-- QUICK_STOP_ACTIVE <----------quick stop--- OPERATION_ENABLED
#         ^
#         +-- FAULT_REACTION_ACTIVE <-- an error of the drive, in every state


class DriveState(enum.Enum):
    """Power state of a CiA 402 drive.

    The number of a power state is the bit pattern of the power state in the status word (object
    0x6041).
    """

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08

    @property
    def powered(self) -> bool:
        """``True`` if the power stage of the drive is on, so that the motor may have torque."""
        return self in (
            DriveState.OPERATION_ENABLED,
            DriveState.QUICK_STOP_ACTIVE,
            DriveState.FAULT_REACTION_ACTIVE,
        )

    @classmethod
    def of(cls, status_word: int) -> DriveState | None:
        """Returns the power state in a status word, or ``None`` if the bits match no state."""
        return _STATES[status_word & 0x6F]


# Power states in whose bit pattern bit 5 of the status word (quick stop inactive) is significant.
_WITH_BIT_5 = (
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
    DriveState.QUICK_STOP_ACTIVE,
)
_STATES = {
    word: next(
        (s for s in DriveState if word & (0x6F if s in _WITH_BIT_5 else 0x4F) == s.value), None
    )
    for word in range(0x70)
}

# Bits of the CiA 402 status word that do not encode the power state.  In the homing mode, bit 12 of
# the status word means "homing attained" and bit 13 means "homing error".
VOLTAGE_ENABLED = 1 << 4
REMOTE = 1 << 9
TARGET_REACHED = 1 << 10
HOMING_ATTAINED = 1 << 12
HOMING_ERROR = 1 << 13


class ControlWord(enum.IntEnum):
    """Commands to a CiA 402 drive, which the master writes to the control word (object 0x6040).

    A drive in the power state FAULT is reset by a rising edge of bit 7 (``FAULT_RESET``) of the
    control word.
    """

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


# Bits of the CiA 402 control word whose meaning depends on the mode of operation.
NEW_SET_POINT, CHANGE_IMMEDIATELY = 1 << 4, 1 << 5
START_HOMING = 1 << 4


class Mode(enum.IntEnum):
    """Mode of operation of a drive: object 0x6060 sets the mode, object 0x6061 reports the mode."""

    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9
