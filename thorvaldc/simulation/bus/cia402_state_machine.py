"""The power state machine of a simulated CiA 402 drive.

The control word changes the state of the drive, and the status word reports the state of the drive.
The module ``thorvaldc.can.cia402`` has a diagram of the drive states.  Bits of the CiA 402 control
word:

    bit 0 switch on   bit 1 enable voltage   bit 2 quick stop (active low)
    bit 3 enable operation   bit 7 fault reset (rising edge)
"""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.can.cia402 import REMOTE, VOLTAGE_ENABLED, DriveState

SWITCH_ON, ENABLE_VOLTAGE, QUICK_STOP, ENABLE_OPERATION, FAULT_RESET = 0x01, 0x02, 0x04, 0x08, 0x80
QUICK_STOP_INACTIVE = 1 << 5
"""Bit 5 of the status word, which is 0 while a quick stop is commanded."""


class Reaction(NamedTuple):
    """A speed ramp that stops the motor, and the drive state after the ramp.

    If ``quick`` is true, the motor stops with the quick stop deceleration (object 0x6085).  If
    ``quick`` is false, the motor stops with the profile deceleration (object 0x6084).
    """

    quick: bool
    next_state: DriveState


class StateMachine:
    """The CiA 402 power state machine of one motor.

    ``reaction`` is the stop ramp that is in progress, or ``None``.  The user of the state machine
    calls ``stopped`` when the motor is at rest after a stop ramp.
    """

    def __init__(self) -> None:
        self.state = DriveState.NOT_READY
        self.reaction: Reaction | None = None
        self._control_word = 0

    def statusword(self) -> int:
        word = self.state.value | REMOTE
        if self.state is not DriveState.NOT_READY:
            word |= VOLTAGE_ENABLED
        if self.state in (DriveState.SWITCH_ON_DISABLED, DriveState.FAULT):
            word |= QUICK_STOP_INACTIVE if self._control_word & QUICK_STOP else 0
        return word

    def command(self, word: int, quick_stop_option: int, disable_option: int) -> None:
        """Handles a received CiA 402 control word.

        ``quick_stop_option`` is the value of object 0x605A, and ``disable_option`` is the value of
        object 0x605C.
        """
        reset = bool(word & FAULT_RESET) and not self._control_word & FAULT_RESET
        self._control_word = word
        state = self.state
        if state is DriveState.FAULT:
            if reset:
                self.state = DriveState.SWITCH_ON_DISABLED
            return
        if state in (DriveState.NOT_READY, DriveState.FAULT_REACTION_ACTIVE):
            return
        if not word & ENABLE_VOLTAGE:
            self.disable()
        elif not word & QUICK_STOP:
            if state is DriveState.OPERATION_ENABLED:
                self.quick_stop(quick_stop_option)
            elif state is not DriveState.QUICK_STOP_ACTIVE:
                self.disable()
        elif not word & SWITCH_ON:
            if state is not DriveState.QUICK_STOP_ACTIVE:
                self._enter(DriveState.READY_TO_SWITCH_ON)
        elif not word & ENABLE_OPERATION:
            self._switch_on(disable_option)
        else:
            self._enable()

    def _switch_on(self, disable_option: int) -> None:
        if self.state is DriveState.READY_TO_SWITCH_ON:
            self._enter(DriveState.SWITCHED_ON)
        elif self.state is DriveState.OPERATION_ENABLED and self.reaction is None:
            if disable_option == 1:
                self.reaction = Reaction(False, DriveState.SWITCHED_ON)
            else:
                self._enter(DriveState.SWITCHED_ON)

    def _enable(self) -> None:
        if self.state in (
            DriveState.READY_TO_SWITCH_ON,
            DriveState.SWITCHED_ON,
            DriveState.OPERATION_ENABLED,
        ):
            self._enter(DriveState.OPERATION_ENABLED)
        elif self.state is DriveState.QUICK_STOP_ACTIVE:
            reaction = self.reaction
            if reaction is None or reaction.next_state is DriveState.QUICK_STOP_ACTIVE:
                self._enter(DriveState.OPERATION_ENABLED)

    def disable(self) -> None:
        """Switches the power stage of the drive off without a stop ramp."""
        if self.state is not DriveState.FAULT:
            self._enter(DriveState.SWITCH_ON_DISABLED)

    def quick_stop(self, option: int) -> None:
        """Starts a quick stop of the motor.

        ``option`` is the quick stop option code (object 0x605A):

        * 0: the power stage is switched off without a ramp.
        * 1 and 2: the motor stops on a ramp, and then the power stage is switched off.
        * 5 and 6: the motor stops on a ramp, and the state remains QUICK STOP ACTIVE.

        The option codes 1 and 5 use the profile deceleration, and the option codes 2 and 6 use the
        quick stop deceleration.
        """
        if self.state is not DriveState.OPERATION_ENABLED:
            return
        if option == 0:
            self.disable()
            return
        stays = option >= 5
        next_state = DriveState.QUICK_STOP_ACTIVE if stays else DriveState.SWITCH_ON_DISABLED
        self.state = DriveState.QUICK_STOP_ACTIVE
        self.reaction = Reaction(option not in (1, 5), next_state)

    def fault(self, option: int) -> bool:
        """Enters the drive state FAULT.

        ``option`` is the value of object 0x605E, which defines whether the motor stops on a ramp
        first.  Returns ``False`` if the drive is in the state FAULT already.
        """
        if self.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return False
        if self.state.powered and option != 0:
            self.state = DriveState.FAULT_REACTION_ACTIVE
            self.reaction = Reaction(option != 1, DriveState.FAULT)
        else:
            self._enter(DriveState.FAULT)
        return True

    def stopped(self) -> None:
        """Enters the drive state that follows a stop ramp, after the motor has stopped."""
        if self.reaction is not None:
            self._enter(self.reaction.next_state)

    def _enter(self, state: DriveState) -> None:
        self.state = state
        self.reaction = None
