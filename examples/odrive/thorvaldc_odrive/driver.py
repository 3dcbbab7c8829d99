"""Driver of an ODrive with one axis that drives a wheel, over CANSimple.

    driver                                          ODrive
    CONFIG   remote frame Get_Version        --->
                                             <---   Get_Version
             RxSdo read watchdog_timeout     --->
                                             <---   TxSdo
             RxSdo read enable_watchdog      --->
                                             <---   TxSdo
    (all match, and Heartbeat, Get_Error and Get_Encoder_Estimates arrive: commands from now on)
    HOMING   Set_Input_Vel 0, every cycle    --->   feeds the watchdog
             Clear_Errors, if there is one   --->
             Set_Controller_Mode velocity    --->
             Set_Axis_State closed loop      --->
                                             <---   Heartbeat "closed_loop_control"
    READY    Set_Input_Vel, every cycle      --->
             RxSdo read, every second        --->
                                             <---   TxSdo
    a stop   Set_Input_Vel 0                 --->   brakes
             Set_Axis_State idle             --->   when the base takes the torque away

The watchdog of the ODrive takes the torque away if no Set_Input_Vel has arrived for
``watchdog_timeout``; the motor then coasts.  A robot must not drive without it, and it is off in a
new ODrive, so that the driver reads it before the start and again and again while the robot drives.
"""

from __future__ import annotations

import math
import struct

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Bus, Node, Robot
from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController
from thorvaldc_odrive.protocol import (
    PASSTHROUGH,
    READ,
    VELOCITY_CONTROL,
    AxisState,
    Error,
    error_names,
)

REPEAT = 0.2
"""Time (s) after which a request of a state is repeated, longer than a period of the heartbeat."""
CLEAR_TIME = 0.5
"""Time (s) after Clear_Errors in which old reports of errors may still arrive."""
ANSWER_TIME = 0.1
"""Time (s) after which a query without an answer is repeated."""
TRIES = 3
SUPERVISION_PERIOD = 1.0
"""Time (s) between two queries while the settings match."""
TIME_TOLERANCE = 1e-6
"""Largest rounding error (s) of a watchdog time with 32 bits."""
POWER_LOSSES = {
    Error.DC_BUS_UNDER_VOLTAGE: "the supply voltage is too low",
    Error.ESTOP_REQUESTED: "its emergency stop was requested",
}


class OdriveController(MotorController):
    """Driver of one ODrive axis for a propulsion motor."""

    checks_watchdog = True

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        properties = dict(node.properties)
        self._firmware = str(properties["firmware"])
        self._endpoints = (
            int(properties["watchdog_timeout_endpoint"]),
            int(properties["enable_watchdog_endpoint"]),
        )
        self._watchdog_timeout = float(properties["watchdog_timeout"])
        self._state: int = AxisState.UNDEFINED
        self._active_errors = 0
        self._disarm_reason = 0
        self._reset_allowed = True
        self._cleared_at = -math.inf
        self._requested_at = -math.inf
        self._mode_sent = False
        self._stopping = False
        self._now = -math.inf
        self._forget_identity()
        for name, handler in (
            ("get_version", self._handle_version),
            ("heartbeat", self._handle_heartbeat),
            ("get_error", self._handle_error),
            ("tx_sdo", self._handle_value),
            ("get_encoder_estimates", self._handle_motion),
        ):
            self.handlers[self.codecs[name].key] = handler

    def _forget_identity(self) -> None:
        self._version: str | None = None
        self._values: dict[int, bytes] = {}
        """Raw values of the endpoints that were read, by endpoint."""
        self._next_query = 0
        self._queried_at = -math.inf
        self._unanswered = 0

    # -- reports -----------------------------------------------------------------------------------

    def _handle_version(self, data: bytes, time: float) -> None:
        values = self.codecs["get_version"].decode_named(data)
        self._version = ".".join(
            str(int(values[f"fw_{part}"])) for part in ("major", "minor", "revision")
        )
        self._unanswered = 0

    def _handle_heartbeat(self, data: bytes, time: float) -> None:
        values = self.codecs["heartbeat"].decode_named(data)
        self._active_errors = int(values["active_errors"])
        self._state = int(values["axis_state"])

    def _handle_error(self, data: bytes, time: float) -> None:
        values = self.codecs["get_error"].decode_named(data)
        self._active_errors = int(values["active_errors"])
        self._disarm_reason = int(values["disarm_reason"])

    def _handle_value(self, data: bytes, time: float) -> None:
        endpoint = int(self.codecs["tx_sdo"].decode(data)[0])
        if endpoint in self._endpoints:
            self._values[endpoint] = data[4:]
            self._unanswered = 0

    def _handle_motion(self, data: bytes, time: float) -> None:
        values = self.codecs["get_encoder_estimates"].decode_named(data)
        for axis in self.axes:
            axis.update(time, values["position"], values["velocity"])

    # -- state -------------------------------------------------------------------------------------

    @property
    def follows(self) -> bool:
        return self._state == AxisState.CLOSED_LOOP_CONTROL

    @property
    def is_off(self) -> bool:
        return self._state == AxisState.IDLE

    @property
    def _errors(self) -> int:
        """Errors that are active or have disarmed the axis, except those that may be cleared."""
        if self._reset_allowed or self._now - self._cleared_at < CLEAR_TIME:
            return 0
        return self._active_errors | self._disarm_reason

    @property
    def watchdog_acted(self) -> bool:
        return self._errors == Error.WATCHDOG_TIMER_EXPIRED

    @property
    def problem(self) -> str:
        problems = [error_names(self._errors)] if self._errors else []
        if self._unanswered > TRIES:
            problems.append("it does not answer RxSdo")
        problems.append(self.identity_mismatch() or "")
        return ", ".join(problem for problem in problems if problem)

    @property
    def power_loss(self) -> str:
        losses = [text for error, text in POWER_LOSSES.items() if self._errors & error]
        return ", ".join(losses)

    @property
    def _known(self) -> bool:
        """``True`` if the version and all endpoints were read since the last start-up."""
        return self._version is not None and len(self._values) == len(self._endpoints)

    def identity_mismatch(self) -> str | None:
        if not self._known:
            return None
        if self._version != self._firmware:
            return f"its firmware is {self._version}, not {self._firmware}"
        timeout_endpoint, enable_endpoint = self._endpoints
        if not any(self._values[enable_endpoint][:1]):
            return "its watchdog is off (axis0.config.enable_watchdog)"
        raw = self._values[timeout_endpoint]
        timeout = struct.unpack_from("<f", raw)[0] if len(raw) >= 4 else math.nan
        if not abs(timeout - self._watchdog_timeout) < TIME_TOLERANCE:
            return (
                f"its watchdog time is {timeout:g} s, not {self._watchdog_timeout:g} s "
                "(axis0.config.watchdog_timeout)"
            )
        return ""

    def allow_reset(self) -> None:
        self._reset_allowed = True
        self._forget_identity()

    # -- frames ------------------------------------------------------------------------------------

    def query_frame(self, now: float) -> CanFrame | None:
        """Returns a remote frame for the version, or a read of an endpoint.

        The version and the endpoints are read one after another, then the endpoints again and
        again.
        """
        period = ANSWER_TIME if self._unanswered or not self._known else SUPERVISION_PERIOD
        if now - self._queried_at < period:
            return None
        self._queried_at = now
        self._unanswered += 1
        if self._version is None:
            version = self.codecs["get_version"]
            return CanFrame(version.frame.cob_id, remote=True, requested=version.length)
        missing = [endpoint for endpoint in self._endpoints if endpoint not in self._values]
        self._next_query = (self._next_query + 1) % len(self._endpoints)
        endpoint = missing[0] if missing else self._endpoints[self._next_query]
        return self.codecs["rx_sdo"].can_frame(struct.pack("<BHB", READ, endpoint, 0))

    def cyclic_frames(self, intent: Intent, now: float) -> list[CanFrame]:
        self._now = now
        if intent is Intent.QUICK_STOP and not self._stopping:
            self.hold()
        self._stopping = intent is Intent.QUICK_STOP
        follows = intent is Intent.FOLLOW and self.follows
        if follows:
            self._reset_allowed = False
        velocity = self.axes[0].target if follows and self.axes else 0.0
        codec = self.codecs["set_input_vel"]
        return [codec.can_frame(codec.encode_named({"input_vel": velocity}))]

    def occasional_frame(self, intent: Intent, now: float) -> CanFrame | None:
        """Returns Clear_Errors, Set_Controller_Mode or Set_Axis_State, or ``None``."""
        state = self._required_state(intent)
        if state == self._state:
            self._mode_sent = False
            return None
        if now - self._requested_at < REPEAT:
            return None
        if state == AxisState.CLOSED_LOOP_CONTROL:
            if self._reset_allowed and self._active_errors | self._disarm_reason:
                self._reset_allowed, self._cleared_at = False, now
                return self._command("clear_errors")
            if not self._mode_sent:
                # The mode is set while the axis is idle, and first of all.
                self._mode_sent = True
                return self._command(
                    "set_controller_mode", control_mode=VELOCITY_CONTROL, input_mode=PASSTHROUGH
                )
        self._requested_at = now
        self._mode_sent = False
        return self._command("set_axis_state", requested_state=state)

    def _required_state(self, intent: Intent) -> int:
        if intent is Intent.FOLLOW:
            return AxisState.CLOSED_LOOP_CONTROL
        if intent is Intent.QUICK_STOP and self.follows:
            return AxisState.CLOSED_LOOP_CONTROL  # the motor keeps its torque
        return AxisState.IDLE

    def _command(self, name: str, **values: float) -> CanFrame:
        codec = self.codecs[name]
        return codec.can_frame(codec.encode_named(values))
