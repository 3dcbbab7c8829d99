"""Driver of CANopen motor controllers with the drive profile CiA 402."""

from __future__ import annotations

import math
from typing import ClassVar, Final

from thorvaldc.can import canopen
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Bus, Node, Robot
from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController
from thorvaldc.runtime.can_base.signal_codec import FrameCodec
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.runtime.mypyc_marks import mypyc_attr

HOMING_SETTLED: Final = 3
"""Number of cycles after the start of a homing in which the homing result is ignored.

In these cycles a drive may still report the result of the previous homing."""
RESET_CYCLES: Final = 5
"""Number of cycles in which a drive must leave the state FAULT after a fault reset."""

_FAULT_STATES: Final = (canopen.DriveState.FAULT, canopen.DriveState.FAULT_REACTION_ACTIVE)
_STEPS_TO_ENABLED: Final = {
    canopen.DriveState.SWITCH_ON_DISABLED: canopen.ControlWord.SHUTDOWN,
    canopen.DriveState.READY_TO_SWITCH_ON: canopen.ControlWord.SWITCH_ON,
    canopen.DriveState.SWITCHED_ON: canopen.ControlWord.ENABLE_OPERATION,
}
"""Control word for the next step to OPERATION_ENABLED, by power state of the drive."""


class _AxisStateMachine:
    """CiA 402 power state machine of one motor, which uses the control word and the status word.

    - ``mode``: mode of operation in which the motor follows its target;
    - ``reported_mode``: mode of operation in the newest report of the drive (object 0x6061).
    """

    def __init__(self, axis: Axis, mode: int) -> None:
        self.axis = axis
        self.mode = mode
        self.status_word: int | None = None
        self.reported_mode = 0
        self.reset_allowed = True
        self.reset_cycles = 0
        self.homing_cycles = 0
        self.homing_failed = False
        self.set_point_bit = False

    @property
    def state(self) -> canopen.DriveState | None:
        return None if self.status_word is None else canopen.DriveState.of(self.status_word)

    @property
    def enabled(self) -> bool:
        return self.state is canopen.DriveState.OPERATION_ENABLED

    @property
    def in_fault(self) -> bool:
        return self.state in _FAULT_STATES

    @property
    def may_recover(self) -> bool:
        """``True`` if a fault reset of the drive is allowed or in progress."""
        return self.reset_allowed or self.reset_cycles > 0

    def update(self, status_word: int, mode: int | None) -> None:
        """Stores a report of the drive and detects the end of a homing."""
        self.status_word = status_word
        if mode is not None:
            self.reported_mode = mode
        homing = (
            self.reported_mode == canopen.Mode.HOMING
            and self.homing_cycles >= HOMING_SETTLED
            and self.enabled
        )
        if not homing or self.axis.homed:
            return
        if status_word & canopen.HOMING_ERROR:
            self.homing_failed = True
        elif status_word & canopen.HOMING_ATTAINED and status_word & canopen.TARGET_REACHED:
            self.axis.homed = True
            self.axis.hold()

    def command(self, intent: Intent) -> tuple[int, int]:
        """Returns the control word and the mode of operation to send to the drive."""
        homes = intent is Intent.HOME and not self.axis.homed
        mode = canopen.Mode.HOMING if homes else self.mode
        if not homes:
            self.homing_cycles = 0
        if self.state is canopen.DriveState.FAULT:
            return self._reset_once(), mode
        if intent is Intent.OFF or self.in_fault:
            return canopen.ControlWord.DISABLE_VOLTAGE, mode
        if intent is Intent.QUICK_STOP:
            # The control word is repeated until the drive itself ends the stop (object 0x605A).
            # `DISABLE_VOLTAGE` would take the torque from a motor that still turns.
            stops = self.enabled or self.state is canopen.DriveState.QUICK_STOP_ACTIVE
            return (
                canopen.ControlWord.QUICK_STOP if stops else canopen.ControlWord.DISABLE_VOLTAGE,
                mode,
            )
        if self.state in _STEPS_TO_ENABLED:
            return _STEPS_TO_ENABLED[self.state], mode
        if not self.enabled:  # after a quick stop the drive must first return to SWITCH_ON_DISABLED
            return canopen.ControlWord.DISABLE_VOLTAGE, mode
        self.reset_allowed, self.reset_cycles = False, 0
        word: int = canopen.ControlWord.ENABLE_OPERATION
        if homes:
            if self.reported_mode == canopen.Mode.HOMING:
                word |= canopen.START_HOMING
                self.homing_cycles += 1
        elif mode == canopen.Mode.PROFILE_POSITION and self.reported_mode == mode:
            # A CiA 402 drive accepts a new target position at a rising edge of the bit
            # NEW_SET_POINT in the control word.  The bit NEW_SET_POINT rises in every second
            # control cycle with the latest target position, so a lost CAN frame only delays the
            # target position.
            self.set_point_bit = not self.set_point_bit
            word |= canopen.CHANGE_IMMEDIATELY | (
                canopen.NEW_SET_POINT if self.set_point_bit else 0
            )
        return word, mode

    def _reset_once(self) -> canopen.ControlWord:
        """Returns the control word for a drive in the power state FAULT: ``FAULT_RESET`` or
        ``DISABLE_VOLTAGE``.

        A CiA 402 drive resets a fault at a rising edge of the bit FAULT_RESET in the control word.
        One fault reset of the drive is allowed at the start-up, and one for each ``reset`` by the
        operator.
        """
        if self.reset_allowed:
            self.reset_allowed, self.reset_cycles = False, RESET_CYCLES
            return canopen.ControlWord.FAULT_RESET
        self.reset_cycles = max(self.reset_cycles - 1, 0)
        return canopen.ControlWord.DISABLE_VOLTAGE


@mypyc_attr(allow_interpreted_subclasses=True)
class Cia402Controller(MotorController):
    """Driver of a CiA 402 motor controller with one or more channels.

    The name of each CAN signal consists of the name of the channel, an underscore and the name of
    the object.  The CAN signals that command a motor channel are ``<channel>_controlword``,
    ``<channel>_mode_of_operation``, and ``<channel>_target_velocity`` or
    ``<channel>_target_position``.  The CAN signals that a motor channel reports are
    ``<channel>_statusword``, ``<channel>_mode_of_operation_display``, ``<channel>_velocity`` and
    ``<channel>_position``.
    """

    powers_single_motors: ClassVar[bool] = True

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        objects = {entry.name: entry.value for entry in node.objects}
        self._machines = [
            _AxisStateMachine(
                axis,
                objects.get(f"{axis.channel}_mode_of_operation")
                or (
                    canopen.Mode.PROFILE_POSITION
                    if axis.steering
                    else canopen.Mode.PROFILE_VELOCITY
                ),
            )
            for axis in self.axes
        ]
        self._commands = [
            (codec, machine)
            for codec in self.codecs.values()
            for machine in self._machines
            if f"{machine.axis.channel}_controlword" in codec.indices
        ]
        for codec in self.codecs.values():
            if any(f"{m.axis.channel}_statusword" in codec.indices for m in self._machines):
                self._add_handler(codec)

    def _add_handler(self, codec: FrameCodec) -> None:
        """Adds a handler that decodes the reports of a drive in one CAN frame.

        The indices of the CAN signals are looked up once, not in every control cycle.
        """
        readers = []
        for machine in self._machines:
            channel, indices = machine.axis.channel, codec.indices
            if f"{channel}_statusword" in indices:
                readers.append(
                    (
                        machine,
                        indices[f"{channel}_statusword"],
                        indices.get(f"{channel}_mode_of_operation_display"),
                        indices.get(f"{channel}_position"),
                        indices.get(f"{channel}_velocity"),
                    )
                )

        def handle(data: bytes, time: float) -> None:
            values = codec.decode(data)
            for machine, status_word, mode, position, velocity in readers:
                axis = machine.axis
                if axis.steering and position is not None:
                    rate = values[velocity] if velocity is not None else None
                    axis.update(time, values[position], rate)
                elif not axis.steering and velocity is not None:
                    axis.update(time, 0.0, values[velocity])
                reported_mode = int(values[mode]) if mode is not None else None
                machine.update(int(values[status_word]), reported_mode)

        self.handlers[codec.key] = handle

    # -- state -----------------------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        return all(
            m.enabled and m.reported_mode in (m.mode, 0) for m in self._machines if m.axis.powered
        )

    @property
    def is_off(self) -> bool:
        return not any(m.state is not None and m.state.powered for m in self._machines)

    @property
    def problem(self) -> str:
        problems = []
        for machine in self._machines:
            channel = machine.axis.channel
            if machine.in_fault and not machine.may_recover:
                problems.append(f"{channel} is in the state FAULT")
            if machine.homing_failed:
                problems.append(f"the homing of {channel} failed")
        if self.error_code and not any(machine.may_recover for machine in self._machines):
            problems.append(f"emergency {self.error_code:#06x}")
        return ", ".join(problems)

    @property
    def power_loss(self) -> str:
        with_voltage = (
            canopen.DriveState.READY_TO_SWITCH_ON,
            canopen.DriveState.SWITCHED_ON,
            canopen.DriveState.OPERATION_ENABLED,
        )
        for machine in self._machines:
            if (
                machine.state in with_voltage
                and not (machine.status_word or 0) & canopen.VOLTAGE_ENABLED
            ):
                return "the power stage has no voltage"
        return ""

    def handle_restart(self) -> None:
        super().handle_restart()
        for machine in self._machines:
            machine.status_word, machine.reported_mode, machine.homing_cycles = None, 0, 0
            machine.homing_failed = False

    def allow_reset(self) -> None:
        self.error_code = 0
        for machine in self._machines:
            machine.reset_allowed, machine.homing_failed = True, False

    # -- commands ----------------------------------------------------------------------------------

    def cyclic_frames(self, intent: Intent, now: float) -> list[CanFrame]:
        frames = []
        for codec, machine in self._commands:
            axis = machine.axis
            word, mode = machine.command(intent if axis.powered else Intent.OFF)
            follows = intent is Intent.FOLLOW and machine.enabled
            if axis.steering and not follows and math.isfinite(axis.position):
                # The target steering angle is the measured angle while the drive is not enabled.
                # The steering joint therefore does not jump to an old target angle when the drive
                # is enabled.
                axis.hold()
            target = axis.target if axis.steering or follows else 0.0
            values = [
                _signal_value(signal.name, axis.channel, word, mode, target)
                for signal in codec.frame.signals
            ]
            frames.append(codec.can_frame(codec.encode(values)))
        return frames


def _signal_value(name: str, channel: str, word: int, mode: int, target: float) -> float:
    signal = name.removeprefix(f"{channel}_")
    if signal == "controlword":
        return word
    if signal == "mode_of_operation":
        return mode
    return target
