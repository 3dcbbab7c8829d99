"""CANopen messages, compared with frames of CiA 301 written out by hand."""

from __future__ import annotations

import pytest

from thorvaldc.can.canopen import (
    HIGHEST_NODE_ID,
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
