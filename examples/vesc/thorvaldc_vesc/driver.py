"""Driver of a VESC that drives a wheel, with the simple commands of the CAN mode VESC.

    driver                                          VESC
    CONFIG                                   <---   STATUS, every cycle
    HOMING   SET_CURRENT 0, every cycle      --->   no torque
    READY    SET_CURRENT_BRAKE, every cycle  --->   below the minimum speed SET_RPM gives no torque
    driving  SET_RPM, every cycle            --->   feeds the timeout, as the other commands
    a stop   SET_CURRENT_BRAKE, every cycle  --->   brakes
             SET_CURRENT 0, every cycle      --->   when the base takes the torque away

STATUS contains speed, current and duty cycle, but no state, no error and no settings.  So the
driver cannot tell an error of a VESC from a motor that does not turn, which the base detects, and
cannot read the timeout, which alone stops a VESC if the driver dies.
"""

from __future__ import annotations

import math

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Bus, Node, Robot
from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController

WITHOUT_TORQUE = 0.5
"""Largest current (A) of a motor without torque, for the noise of the measurement."""


class VescController(MotorController):
    """Driver of one VESC for a propulsion motor."""

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        properties = dict(node.properties)
        signal = self.codecs["set_rpm"].frame.signals[0]
        self._minimum_speed = float(properties["minimum_erpm"]) * abs(signal.scale)
        self._brake_current = float(properties["brake_current"])
        self._current = self._duty_cycle = math.nan
        self._reported_at = -math.inf
        self._driven_since = math.inf
        self._stopping = False
        self.handlers[self.codecs["status"].key] = self._handle_status

    def _handle_status(self, data: bytes, time: float) -> None:
        values = self.codecs["status"].decode_named(data)
        self._current, self._duty_cycle = values["current"], values["duty_cycle"]
        self._reported_at = time
        for axis in self.axes:
            axis.update(time, 0.0, values["erpm"])

    # -- state -------------------------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        """A VESC reports no state: it follows if it has reported since it was commanded to."""
        return self._reported_at > self._driven_since

    @property
    def is_off(self) -> bool:
        return abs(self._current) <= WITHOUT_TORQUE and self._duty_cycle == 0.0

    @property
    def problem(self) -> str:
        return ""

    def allow_reset(self) -> None:
        """Does nothing: a VESC clears its errors by itself."""

    # -- frames ------------------------------------------------------------------------------------

    def cyclic_frames(self, intent: Intent, now: float) -> list[CanFrame]:
        if intent is Intent.QUICK_STOP and not self._stopping:
            self.hold()
        self._stopping = intent is Intent.QUICK_STOP
        if intent not in (Intent.FOLLOW, Intent.QUICK_STOP):
            self._driven_since = math.inf
            return [self._command("set_current", 0.0)]
        self._driven_since = min(self._driven_since, now)
        speed = self.axes[0].target if intent is Intent.FOLLOW and self.follows else 0.0
        if not math.isfinite(speed):
            raise ValueError(f"the speed of {self.node.name} is {speed}")
        if abs(speed) < self._minimum_speed or speed == 0.0:
            return [self._command("set_current_brake", self._brake_current)]
        return [self._command("set_rpm", speed)]

    def _command(self, name: str, value: float) -> CanFrame:
        codec = self.codecs[name]
        return codec.can_frame(codec.encode([value]))
