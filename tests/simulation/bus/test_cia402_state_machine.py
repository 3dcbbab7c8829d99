"""Transitions of the power states of a simulated CiA 402 drive."""

from __future__ import annotations

import pytest

from thorvaldc.can.canopen import DriveState
from thorvaldc.simulation.bus.cia402_motion import Reaction, StateMachine

NOT_READY, DISABLED, READY = (
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
)
SWITCHED_ON, ENABLED = DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED
STOPPING, REACTING, FAULT = (
    DriveState.QUICK_STOP_ACTIVE,
    DriveState.FAULT_REACTION_ACTIVE,
    DriveState.FAULT,
)
DISABLE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, RESET = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80


def machine(state: DriveState) -> StateMachine:
    states = StateMachine()
    states.state = state
    return states


@pytest.mark.parametrize(
    ("state", "after"),
    [
        # The state after disable voltage, quick stop, shutdown, switch on, enable, fault reset.
        (NOT_READY, [NOT_READY] * 6),
        (DISABLED, [DISABLED, DISABLED, READY, DISABLED, DISABLED, DISABLED]),
        (READY, [DISABLED, DISABLED, READY, SWITCHED_ON, ENABLED, DISABLED]),
        (SWITCHED_ON, [DISABLED, DISABLED, READY, SWITCHED_ON, ENABLED, DISABLED]),
        (ENABLED, [DISABLED, STOPPING, READY, SWITCHED_ON, ENABLED, DISABLED]),
        (STOPPING, [DISABLED, STOPPING, STOPPING, STOPPING, ENABLED, DISABLED]),
        (REACTING, [REACTING] * 6),
        (FAULT, [FAULT, FAULT, FAULT, FAULT, FAULT, DISABLED]),
    ],
)
def test_commands(state: DriveState, after: list[DriveState]) -> None:
    reached = []
    for word in (DISABLE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, RESET):
        states = machine(state)
        states.command(word, 2, 0)
        reached.append(states.state)
    assert reached == after


def test_a_fault_reset_is_a_rising_edge() -> None:
    states = machine(NOT_READY)
    states.command(RESET, 2, 1)
    states.state = FAULT
    states.command(RESET, 2, 1)
    assert states.state is FAULT
    states.command(0, 2, 1)
    states.command(RESET, 2, 1)
    assert states.state is DISABLED


@pytest.mark.parametrize(
    ("option", "state", "reaction"),
    [
        (0, DISABLED, None),
        (1, STOPPING, Reaction(False, DISABLED)),
        (2, STOPPING, Reaction(True, DISABLED)),
        (5, STOPPING, Reaction(False, STOPPING)),
        (6, STOPPING, Reaction(True, STOPPING)),
    ],
)
def test_quick_stop_options(option: int, state: DriveState, reaction: Reaction | None) -> None:
    states = machine(ENABLED)
    states.command(QUICK_STOP, option, 1)
    assert (states.state, states.reaction) == (state, reaction)
    states.command(QUICK_STOP, option, 1)
    assert (states.state, states.reaction) == (state, reaction)
    states.command(ENABLE, option, 1)
    assert states.state is (ENABLED if option >= 5 else state), "no return while it ramps down"
    states = machine(ENABLED)
    states.command(QUICK_STOP, option, 1)
    states.stopped()
    assert states.state is (STOPPING if option >= 5 else DISABLED)
    assert states.reaction is None
    for other in (DISABLED, READY, SWITCHED_ON, STOPPING, FAULT):
        states = machine(other)
        states.quick_stop(option)
        assert (states.state, states.reaction) == (other, None)


def test_disabling_with_a_ramp() -> None:
    states = machine(ENABLED)
    states.command(SWITCH_ON, 2, 1)
    assert (states.state, states.reaction) == (ENABLED, Reaction(False, SWITCHED_ON))
    states.command(SWITCH_ON, 2, 0)
    assert states.state is ENABLED, "the ramp goes on"
    states.stopped()
    assert (states.state, states.reaction) == (SWITCHED_ON, None)
    states.stopped()
    assert states.state is SWITCHED_ON


@pytest.mark.parametrize(
    ("state", "option", "after", "reaction"),
    [
        (ENABLED, 0, FAULT, None),
        (ENABLED, 1, REACTING, Reaction(False, FAULT)),
        (ENABLED, 2, REACTING, Reaction(True, FAULT)),
        (STOPPING, 2, REACTING, Reaction(True, FAULT)),
        (SWITCHED_ON, 2, FAULT, None),
        (DISABLED, 1, FAULT, None),
    ],
)
def test_faults(
    state: DriveState, option: int, after: DriveState, reaction: Reaction | None
) -> None:
    states = machine(state)
    assert states.fault(option)
    assert (states.state, states.reaction) == (after, reaction)
    assert not states.fault(option), "it has a fault already"
    states.stopped()
    assert states.state is FAULT
    states.disable()
    assert states.state is FAULT


@pytest.mark.parametrize(
    ("state", "word", "status"),
    [
        (NOT_READY, ENABLE, 0x200),
        (DISABLED, 0, 0x250),
        (DISABLED, 0x04, 0x270),
        (READY, SHUTDOWN, 0x231),
        (SWITCHED_ON, SWITCH_ON, 0x233),
        (ENABLED, ENABLE, 0x237),
        (STOPPING, QUICK_STOP, 0x217),
        (FAULT, 0, 0x218),
        (FAULT, 0x04, 0x238),
    ],
)
def test_status_word(state: DriveState, word: int, status: int) -> None:
    states = machine(NOT_READY)
    states.command(word, 2, 1)
    states.state = state
    assert states.statusword() == status
