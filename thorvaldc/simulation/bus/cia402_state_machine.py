"""The power state machine of CiA 402: control word in, status word out."""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.can.cia402 import DriveState

VOLTAGE_ENABLED, REMOTE = 1 << 4, 1 << 9


class Reaction(NamedTuple):
    """A ramp to rest, ``quick`` by 0x6085 or else by 0x6084, and the state that follows."""

    quick: bool
    then: DriveState


class StateMachine:
    """``reaction`` is the stop under way, if any; its owner says when it is ``stopped``."""

    def __init__(self) -> None:
        self.state = DriveState.NOT_READY
        self.reaction: Reaction | None = None
        self._word = 0

    def statusword(self) -> int:
        word = self.state.value | REMOTE
        if self.state is not DriveState.NOT_READY:
            word |= VOLTAGE_ENABLED
        if self.state in (DriveState.SWITCH_ON_DISABLED, DriveState.FAULT):
            word |= 1 << 5 if not self._quick_stop_asked() else 0
        return word

    def command(self, word: int, quick_stop_option: int, disable_option: int) -> None:
        """Take a control word; options are those of 0x605A and 0x605C."""
        reset = bool(word & 0x80) and not self._word & 0x80
        self._word = word
        state = self.state
        if state is DriveState.FAULT:
            if reset:
                self.state = DriveState.SWITCH_ON_DISABLED
            return
        if state in (DriveState.NOT_READY, DriveState.FAULT_REACTION_ACTIVE):
            return
        if not word & 0x02:
            self.disable()
        elif not word & 0x04:
            if state is DriveState.OPERATION_ENABLED:
                self.quick_stop(quick_stop_option)
            elif state is not DriveState.QUICK_STOP_ACTIVE:
                self.disable()
        elif not word & 0x01:
            if state is not DriveState.QUICK_STOP_ACTIVE:
                self._go(DriveState.READY_TO_SWITCH_ON)
        elif not word & 0x08:
            self._switch_on(disable_option)
        else:
            self._enable()

    def _switch_on(self, disable_option: int) -> None:
        if self.state is DriveState.READY_TO_SWITCH_ON:
            self._go(DriveState.SWITCHED_ON)
        elif self.state is DriveState.OPERATION_ENABLED and self.reaction is None:
            if disable_option == 1:
                self.reaction = Reaction(False, DriveState.SWITCHED_ON)
            else:
                self._go(DriveState.SWITCHED_ON)

    def _enable(self) -> None:
        if self.state in (
            DriveState.READY_TO_SWITCH_ON,
            DriveState.SWITCHED_ON,
            DriveState.OPERATION_ENABLED,
        ):
            self._go(DriveState.OPERATION_ENABLED)
        elif self.state is DriveState.QUICK_STOP_ACTIVE:
            stays = self.reaction is None or self.reaction.then is DriveState.QUICK_STOP_ACTIVE
            if stays:
                self._go(DriveState.OPERATION_ENABLED)

    def disable(self) -> None:
        """Power stage off at once."""
        if self.state is not DriveState.FAULT:
            self._go(DriveState.SWITCH_ON_DISABLED)

    def quick_stop(self, option: int) -> None:
        """``option`` of 0x605A: 0 off at once, 1 and 2 ramp and off, 5 and 6 ramp and stay."""
        if self.state is not DriveState.OPERATION_ENABLED:
            return
        if option == 0:
            self.disable()
            return
        stays = option >= 5
        then = DriveState.QUICK_STOP_ACTIVE if stays else DriveState.SWITCH_ON_DISABLED
        self.state = DriveState.QUICK_STOP_ACTIVE
        self.reaction = Reaction(option not in (1, 5), then)

    def fault(self, option: int) -> bool:
        """Go to fault, with a ramp first where 0x605E says so; ``False``: it is there already."""
        if self.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return False
        if self.state.powered and option != 0:
            self.state = DriveState.FAULT_REACTION_ACTIVE
            self.reaction = Reaction(option != 1, DriveState.FAULT)
        else:
            self._go(DriveState.FAULT)
        return True

    def stopped(self) -> None:
        """The ramp of the reaction has come to rest."""
        if self.reaction is not None:
            self._go(self.reaction.then)

    def _go(self, state: DriveState) -> None:
        self.state = state
        self.reaction = None

    def _quick_stop_asked(self) -> bool:
        return not self._word & 0x04
