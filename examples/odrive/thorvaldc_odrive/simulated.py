"""A simulated ODrive with one axis.

Not published and therefore assumed: the watchdog runs only in closed-loop control and begins when
the axis enters it; Clear_Errors and Set_Axis_State take effect at once; the periods of the cyclic
messages have random phases.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING

from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel
from thorvaldc_odrive.protocol import (
    BROADCAST_ID,
    READ,
    VELOCITY_CONTROL,
    AxisState,
    Command,
    Error,
)

if TYPE_CHECKING:
    from thorvaldc.simulation.bus.simulated_device import DeviceSpecification

LOOP_PERIOD = 0.005
"""Period (s) in which the watchdog is checked; that of an ODrive is shorter."""
BOOT_TIME = 0.5
"""Time (s) without frames after Reboot."""
NODE_ID, ENABLE_WATCHDOG, WATCHDOG_TIMEOUT = "node_id", "enable_watchdog", "watchdog_timeout"
"""Keys of the values in non-volatile memory."""


class Odrive(SimulatedDevice):
    """A simulated ODrive.

    - ``radians``: angle (rad) of the joint for a revolution of the motor shaft.
    - ``periods``: period (s) of each cyclic message.
    - ``active_errors``, ``disarm_reason``: errors, see ``Error``.
    """

    def __init__(self, specification: DeviceSpecification) -> None:
        node = specification.node
        memory = {
            # A delivered ODrive has no node id, and its watchdog is off.
            NODE_ID: BROADCAST_ID if specification.delivered else node.id,
            ENABLE_WATCHDOG: not specification.delivered,
            WATCHDOG_TIMEOUT: float(specification.property("watchdog_timeout")),
        }
        super().__init__(specification, memory)
        actuator = specification.actuator(node.channels[0].name)
        self.motor: MotorModel = specification.motor_of(actuator)
        self.radians = math.tau / (1.0 if actuator is None else actuator.gear_ratio)
        self.periods = {
            command: specification.period(command.identifier(node.id), 0.0) for command in Command
        }
        self.endpoints = (
            int(specification.property("watchdog_timeout_endpoint")),
            int(specification.property("enable_watchdog_endpoint")),
        )
        major, minor, revision = str(specification.property("firmware")).split(".")
        self.firmware = int(major), int(minor), int(revision)
        # Only the sign, the position and the failures of the encoder matter here.
        self.encoder = Encoder(1.0, 1024)
        self.active_errors = self.disarm_reason = Error(0)
        self.state = AxisState.IDLE
        self.enable_watchdog = True
        self._control_mode = 0
        self._fed_at = -math.inf

    @property
    def node_id(self) -> int:
        return int(self.nonvolatile[NODE_ID])

    # -- start and stop ----------------------------------------------------------------------------

    def start(self) -> None:
        self.active_errors = self.disarm_reason = Error(0)
        self.state = AxisState.IDLE
        self.enable_watchdog = bool(self.nonvolatile[ENABLE_WATCHDOG])
        self.encoder.set_zero(self.motor.read(self.now))
        self._add_handlers()
        self.every(lambda: LOOP_PERIOD, self._check_watchdog, first=LOOP_PERIOD)
        for command, message in self._messages().items():
            period = self.periods.get(command, 0.0)
            if period > 0.0:
                send = self._sender(command, message)
                self.every(self._period(period), send, first=self.random.uniform(0.0, period))

    def stop(self) -> None:
        self.state = AxisState.UNDEFINED
        self.motor.release(self.now)

    def _add_handlers(self) -> None:
        handlers = {
            Command.ESTOP: lambda _: self.disarm(Error.ESTOP_REQUESTED),
            Command.RX_SDO: self._handle_sdo,
            Command.SET_AXIS_STATE: self._handle_state,
            Command.SET_CONTROLLER_MODE: self._handle_mode,
            Command.SET_INPUT_VEL: self._handle_velocity,
            Command.REBOOT: self._handle_reboot,
            Command.CLEAR_ERRORS: lambda _: self._clear_errors(),
        }
        self.handlers = {c.identifier(self.node_id): handler for c, handler in handlers.items()}
        self.remote_handlers = {
            command.identifier(self.node_id): self._answer(command, message)
            for command, message in self._messages().items()
        }

    def change_node_id(self, node_id: int) -> None:
        if not 0 <= node_id < BROADCAST_ID:
            raise ValueError(f"a node id is 0 to {BROADCAST_ID - 1}, not {node_id}")
        self.nonvolatile[NODE_ID] = node_id
        self._add_handlers()

    def lose_watchdog(self) -> None:
        self.enable_watchdog = False

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        return self.encoder, self.motor

    # -- axis --------------------------------------------------------------------------------------

    def disarm(self, reason: Error) -> None:
        """Takes the torque away because of an error."""
        self.disarm_reason |= reason
        self._idle()

    def fail(self, error: Error) -> None:
        """Sets an active error, which disarms the axis; a test imitates a defect with it."""
        self.active_errors |= error
        self.disarm(error)

    def _idle(self) -> None:
        self.state = AxisState.IDLE
        self.motor.release(self.now)

    def _clear_errors(self) -> None:
        self.active_errors = self.disarm_reason = Error(0)

    def _check_watchdog(self) -> None:
        expired = self.now - self._fed_at > self.nonvolatile[WATCHDOG_TIMEOUT]
        if self.enable_watchdog and expired and self.state is AxisState.CLOSED_LOOP_CONTROL:
            self.disarm(Error.WATCHDOG_TIMER_EXPIRED)

    def _handle_state(self, frame: CanFrame) -> None:
        (requested,) = struct.unpack_from("<I", frame.data)
        if requested == AxisState.IDLE:
            self._idle()
        elif requested == AxisState.CLOSED_LOOP_CONTROL and not self.active_errors:
            self.state, self._fed_at = AxisState.CLOSED_LOOP_CONTROL, self.now
            self.motor.turn(0.0, self.now)

    def _handle_mode(self, frame: CanFrame) -> None:
        self._control_mode = struct.unpack_from("<I", frame.data)[0]

    def _handle_velocity(self, frame: CanFrame) -> None:
        velocity, _ = struct.unpack("<ff", frame.data)
        self._fed_at = self.now
        if self.state is AxisState.CLOSED_LOOP_CONTROL and self._control_mode == VELOCITY_CONTROL:
            self.motor.turn(velocity * self.radians, self.now)

    def _handle_sdo(self, frame: CanFrame) -> None:
        opcode, endpoint, _ = struct.unpack_from("<BHB", frame.data)
        timeout_endpoint, enable_endpoint = self.endpoints
        values = {
            timeout_endpoint: struct.pack("<f", self.nonvolatile[WATCHDOG_TIMEOUT]),
            enable_endpoint: struct.pack("<?", self.enable_watchdog),
        }
        if opcode == READ and endpoint in values:
            head = struct.pack("<BHB", 0, endpoint, 0)
            self.send(Command.TX_SDO.identifier(self.node_id), head + values[endpoint])

    def _handle_reboot(self, frame: CanFrame) -> None:
        if frame.data[:1] == b"\0":
            self.power_off()
            self.timeline.after(to_ns(BOOT_TIME), self.power_on)

    # -- reports -----------------------------------------------------------------------------------

    def _messages(self) -> dict[Command, Callable[[], bytes]]:
        return {
            Command.GET_VERSION: lambda: bytes([2, 4, 4, 58, *self.firmware, 0]),
            Command.HEARTBEAT: lambda: struct.pack("<IBBBx", self.active_errors, self.state, 0, 0),
            Command.GET_ERROR: lambda: struct.pack("<II", self.active_errors, self.disarm_reason),
            Command.GET_ENCODER_ESTIMATES: self._estimates,
            Command.GET_TEMPERATURE: lambda: struct.pack("<ff", 30.0, 30.0),
            Command.GET_BUS_VOLTAGE_CURRENT: lambda: struct.pack("<ff", 24.0, 0.5),
        }

    def _estimates(self) -> bytes:
        position, velocity = self.encoder.measure(self.motor.read(self.now))
        return struct.pack("<ff", position / self.radians, velocity / self.radians)

    def _sender(self, command: Command, message: Callable[[], bytes]) -> Callable[[], None]:
        return lambda: self.send(command.identifier(self.node_id), message())

    def _answer(self, command: Command, message: Callable[[], bytes]) -> Callable[[CanFrame], None]:
        return lambda _: self.send(command.identifier(self.node_id), message())

    @staticmethod
    def _period(period: float) -> Callable[[], float]:
        return lambda: period
