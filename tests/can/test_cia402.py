"""Power states in status words, compared with the table of CiA 402."""

from __future__ import annotations

import itertools

from thorvaldc.can import cia402
from thorvaldc.can.cia402 import DriveState

TABLE = {
    "x0xx0000": DriveState.NOT_READY,
    "x1xx0000": DriveState.SWITCH_ON_DISABLED,
    "x01x0001": DriveState.READY_TO_SWITCH_ON,
    "x01x0011": DriveState.SWITCHED_ON,
    "x01x0111": DriveState.OPERATION_ENABLED,
    "x00x0111": DriveState.QUICK_STOP_ACTIVE,
    "x0xx1111": DriveState.FAULT_REACTION_ACTIVE,
    "x0xx1000": DriveState.FAULT,
}


def test_every_status_word_has_the_state_of_the_table() -> None:
    states: dict[int, DriveState] = {}
    for pattern, state in TABLE.items():
        choices = [("0", "1") if bit == "x" else (bit,) for bit in pattern]
        states.update({int("".join(bits), 2): state for bits in itertools.product(*choices)})
    for word in range(256):
        assert DriveState.of(word | 0x1600) is states.get(word), f"{word:08b}"


def test_the_other_bits_of_status_words_are_those_of_the_table() -> None:
    assert cia402.VOLTAGE_ENABLED == 0x0010
    assert cia402.REMOTE == 0x0200
    assert cia402.TARGET_REACHED == 0x0400
    assert cia402.HOMING_ATTAINED == 0x1000
    assert cia402.HOMING_ERROR == 0x2000
