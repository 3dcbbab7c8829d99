"""Drives after CiA 402 on CANopen: control word out, status word in, per axis."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.model.bus import Bus, Node, ObjectValue
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.can_base.motor_controller import Axis, Intent, Message, MotorController
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

# Status word under the mask 0x6F (and 0x4F for faults), control words: CiA 402.
MASK, FAULT_MASK = 0x6F, 0x4F
SWITCH_ON_DISABLED, READY_TO_SWITCH_ON, SWITCHED_ON = 0x40, 0x21, 0x23
OPERATION_ENABLED, QUICK_STOP_ACTIVE = 0x27, 0x07
FAULT, FAULT_REACTION = 0x08, 0x0F
DISABLE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, RESET = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
NEW_SET_POINT, IMMEDIATELY, START_HOMING = 0x10, 0x20, 0x10
VOLTAGE_ENABLED, REACHED, HOMING_ATTAINED, HOMING_ERROR = 1 << 4, 1 << 10, 1 << 12, 1 << 13
PROFILE_POSITION, HOMING_MODE = 1, 6
SETTLED = 3
"""Cycles after the start of a homing from which its end is believed."""
GRACE = 5
"""Cycles that a drive has to leave its fault after a reset."""


class _Motor:
    """What an axis says of itself and is told; ``mode`` is that in which it drives."""

    def __init__(self, axis: Axis, mode: int) -> None:
        self.axis = axis
        self.mode = mode
        self.status: int | None = None
        self.mode_shown = 0
        self.reset_allowed = True
        self.grace = 0
        self.started = 0
        self.homing_failed = False
        self.pulse = False

    @property
    def state(self) -> int:
        if self.status is None:
            return -1
        if self.status & FAULT_MASK in (FAULT, FAULT_REACTION):
            return self.status & FAULT_MASK
        return self.status & (FAULT_MASK if self.status & 0x40 else MASK)

    @property
    def enabled(self) -> bool:
        return self.state == OPERATION_ENABLED

    @property
    def in_fault(self) -> bool:
        return self.state in (FAULT, FAULT_REACTION)

    @property
    def forgiven(self) -> bool:
        """Whether a fault may still go away by a reset."""
        return self.reset_allowed or self.grace > 0

    def take(self, status: int, mode: int | None) -> None:
        self.status = status
        if mode is not None:
            self.mode_shown = mode
        homing = self.mode_shown == HOMING_MODE and self.started >= SETTLED and self.enabled
        if not homing or self.axis.homed:
            return
        if status & HOMING_ERROR:
            self.homing_failed = True
        elif status & HOMING_ATTAINED and status & REACHED:
            self.axis.homed = True
            self.axis.target = self.axis.position

    def word(self, intent: Intent) -> tuple[int, int]:
        """Control word and mode of operation of this cycle."""
        homes = intent is Intent.HOME and not self.axis.homed
        mode = HOMING_MODE if homes else self.mode
        if not homes:
            self.started = 0
        if self.state == FAULT:
            # A reset is a rising edge; one is allowed at the start and by the operator.
            if self.reset_allowed:
                self.reset_allowed, self.grace = False, GRACE
                return RESET, mode
            self.grace = max(self.grace - 1, 0)
            return DISABLE, mode
        if intent is Intent.OFF or self.in_fault:
            return DISABLE, mode
        if intent is Intent.QUICK_STOP:
            return QUICK_STOP if self.enabled else DISABLE, mode
        if self.state == SWITCH_ON_DISABLED:
            return SHUTDOWN, mode
        if self.state == READY_TO_SWITCH_ON:
            return SWITCH_ON, mode
        if self.state == SWITCHED_ON:
            return ENABLE, mode
        if self.state == QUICK_STOP_ACTIVE:
            return DISABLE, mode
        if not self.enabled:
            return DISABLE, mode
        self.reset_allowed, self.grace = False, 0
        word = ENABLE
        if homes:
            if self.mode_shown == HOMING_MODE:
                word |= START_HOMING
                self.started += 1
        elif mode == PROFILE_POSITION and self.mode_shown == mode:
            # A set-point is taken at the rising edge of its bit; the same one again does no
            # harm, and makes good for a frame that was lost.
            self.pulse = not self.pulse
            word |= IMMEDIATELY | (NEW_SET_POINT if self.pulse else 0)
        return word, mode


class Cia402Controller(MotorController):
    """A drive of one axis or several; the signals are named after channel and object.

    ``<channel>_controlword``, ``_mode_of_operation``, ``_target_velocity`` or
    ``_target_position`` out; ``_statusword``, ``_mode_of_operation_display``,
    ``_velocity`` or ``_position`` in.
    """

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        values = {entry.name: entry.value for entry in node.objects}
        self._motors = [
            _Motor(
                axis,
                values.get(f"{axis.channel}_mode_of_operation") or (1 if axis.steering else 3),
            )
            for axis in self.axes
        ]
        self._commands = [
            (codec, motor)
            for codec in self.codecs.values()
            for motor in self._motors
            if f"{motor.axis.channel}_controlword" in codec.places
        ]
        for codec in self.codecs.values():
            if any(f"{m.axis.channel}_statusword" in codec.places for m in self._motors):
                self._listen(codec)

    def _listen(self, codec: FrameCodec) -> None:
        readers = []
        for motor in self._motors:
            channel, places = motor.axis.channel, codec.places
            if f"{channel}_statusword" in places:
                readers.append(
                    (
                        motor,
                        places[f"{channel}_statusword"],
                        places.get(f"{channel}_mode_of_operation_display"),
                        places.get(f"{channel}_position"),
                        places.get(f"{channel}_velocity"),
                    )
                )

        def take(data: bytes, time: float) -> None:
            values = codec.decode(data)
            for motor, status, mode, position, velocity in readers:
                axis = motor.axis
                if axis.steering and position is not None:
                    speed = values[velocity] if velocity is not None else None
                    axis.measured(time, values[position], speed)
                elif not axis.steering and velocity is not None:
                    axis.measured(time, 0.0, values[velocity])
                shown = int(values[mode]) if mode is not None else None
                motor.take(int(values[status]), shown)

        self.handlers[codec.cob_id] = take

    # -- what it says of itself ------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        return all(m.enabled and m.mode_shown in (m.mode, 0) for m in self._motors)

    @property
    def is_off(self) -> bool:
        powered = (OPERATION_ENABLED, QUICK_STOP_ACTIVE, FAULT_REACTION)
        return all(motor.state not in powered for motor in self._motors)

    @property
    def problem(self) -> str:
        said = []
        for motor in self._motors:
            name = motor.axis.channel
            if motor.in_fault and not motor.forgiven:
                said.append(f"{name} is in fault")
            if motor.homing_failed:
                said.append(f"the homing of {name} failed")
        if self.error_code and not any(motor.forgiven for motor in self._motors):
            said.append(f"emergency {self.error_code:#06x}")
        return ", ".join(said)

    @property
    def unpowered(self) -> str:
        ready = (READY_TO_SWITCH_ON, SWITCHED_ON, OPERATION_ENABLED)
        for motor in self._motors:
            if motor.state in ready and not (motor.status or 0) & VOLTAGE_ENABLED:
                return "the power stage has no voltage"
        return ""

    def objects(self) -> Iterator[ObjectValue]:
        return (entry for entry in self.node.objects if entry.value is not None)

    def restarted(self) -> None:
        super().restarted()
        for motor in self._motors:
            motor.status, motor.mode_shown, motor.started = None, 0, 0
            motor.homing_failed = False

    def allow_reset(self) -> None:
        self.error_code = 0
        for motor in self._motors:
            motor.reset_allowed, motor.homing_failed = True, False

    # -- commands ----------------------------------------------------------------------------------

    def cyclic(self, intent: Intent, now: float) -> list[Message]:
        messages = []
        for codec, motor in self._commands:
            word, mode = motor.word(intent)
            axis = motor.axis
            follows = intent is Intent.FOLLOW and motor.enabled
            if axis.steering and not follows and math.isfinite(axis.position):
                # Nothing old waits for it when it is enabled.
                axis.target = axis.position
            target = axis.target if axis.steering or follows else 0.0
            values = [
                _value(signal.name, axis.channel, word, mode, target)
                for signal in codec.frame.signals
            ]
            messages.append(Message(codec.cob_id, codec.encode(values)))
        return messages


def _value(name: str, channel: str, word: int, mode: int, target: float) -> float:
    own = name.removeprefix(f"{channel}_")
    if own == "controlword":
        return word
    if own == "mode_of_operation":
        return mode
    return target
