"""CANopen messages, compared with frames of CiA 301 written out by hand."""

from __future__ import annotations

import itertools

import pytest

from thorvaldc.can import canopen, lss
from thorvaldc.can.canopen import (
    HIGHEST_NODE_ID,
    DriveState,
    Emergency,
    NmtCommand,
    NmtState,
    heartbeat_state,
    nmt_message,
    nmt_state_text,
)


def test_nmt_messages() -> None:
    assert nmt_message(NmtCommand.START, 0) == bytes.fromhex("0100")
    assert nmt_message(NmtCommand.ENTER_PRE_OPERATIONAL, 5) == bytes.fromhex("8005")
    assert nmt_message(NmtCommand.RESET_NODE, 127) == bytes.fromhex("817f")


def test_states_of_a_heartbeat() -> None:
    assert heartbeat_state(b"\x05") == heartbeat_state(b"\x85") == NmtState.OPERATIONAL
    names = [nmt_state_text(state) for state in (0, 4, 5, 127, 9)]
    assert names == ["boot-up", "stopped", "operational", "pre-operational", "0x09"]


def test_node_ids_have_seven_bits() -> None:
    assert HIGHEST_NODE_ID == 0x7F


def test_emergency_messages() -> None:
    data = bytes.fromhex("3081110700000000")
    assert Emergency(0x8130, 0x11, b"\x07").pack() == data
    assert Emergency.unpack(data) == Emergency(0x8130, 0x11, b"\x07\0\0\0\0")
    assert Emergency.unpack(b"\x10\x23").register is None
    with pytest.raises(ValueError, match="1 bytes"):
        Emergency.unpack(b"\x10")


# Power states in status words, compared with the table of CiA 402.

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
    assert canopen.VOLTAGE_ENABLED == 0x0010
    assert canopen.REMOTE == 0x0200
    assert canopen.TARGET_REACHED == 0x0400
    assert canopen.HOMING_ATTAINED == 0x1000
    assert canopen.HOMING_ERROR == 0x2000


# Numbers of LSS, compared with the tables of CiA 305.


def test_the_table_of_bit_timings() -> None:
    kbit_s = {0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6: 50, 7: 20, 8: 10}
    assert {index: 1000 * rate for index, rate in kbit_s.items()} == lss.BITRATES


def test_the_node_id_of_a_device_without_one() -> None:
    assert lss.UNCONFIGURED == 0xFF
