"""Drive profile CiA 402 (IEC 61800-7-201): power states, status word, control word, modes.

The master steps the power state machine with the control word (object 0x6040) and reads the state
from the status word (0x6041):

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
    """Power state.  Its value is the pattern of the status word under the mask of the state."""

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
        """``True`` where the power stage is on: the motor may have torque."""
        return self in (
            DriveState.OPERATION_ENABLED,
            DriveState.QUICK_STOP_ACTIVE,
            DriveState.FAULT_REACTION_ACTIVE,
        )

    @classmethod
    def of(cls, status_word: int) -> DriveState | None:
        """Returns the state in a status word; ``None`` where the bits match no state."""
        return _STATES[status_word & 0x6F]


# Bit 5 of the status word (quick stop inactive) belongs to the pattern of these states only.
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

# Other bits of the status word.  Bits 12 and 13 have these meanings in homing mode.
VOLTAGE_ENABLED = 1 << 4
REMOTE = 1 << 9
TARGET_REACHED = 1 << 10
HOMING_ATTAINED = 1 << 12
HOMING_ERROR = 1 << 13


class ControlWord(enum.IntEnum):
    """Commands of the control word; a fault is reset by the rising edge of bit 7."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


# Bits of the control word that depend on the mode of operation.
NEW_SET_POINT, CHANGE_IMMEDIATELY = 1 << 4, 1 << 5
START_HOMING = 1 << 4


class Mode(enum.IntEnum):
    """Mode of operation (objects 0x6060 and 0x6061)."""

    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9
