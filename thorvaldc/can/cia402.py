"""Drive profile CiA 402 (IEC 61800-7-201): power states, status word, control word, modes.

The master writes the control word (object 0x6040) to change the power state of a drive.  The master
reads the power state from the status word (object 0x6041).  Power states of a CiA 402 drive:

    NOT_READY --> SWITCH_ON_DISABLED --shutdown--> READY_TO_SWITCH_ON --switch on--> SWITCHED_ON
                        ^  ^                                                            |
       fault reset      |  | disable voltage, from every state          enable operation |
                        |  |                                                            v
      FAULT ------------+  +-- QUICK_STOP_ACTIVE <----------quick stop--- OPERATION_ENABLED
        ^
        +-- FAULT_REACTION_ACTIVE <-- an error of the drive, in every state
"""

from __future__ import annotations

import enum


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
