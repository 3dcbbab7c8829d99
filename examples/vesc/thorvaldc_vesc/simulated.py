"""A simulated VESC in the CAN mode VESC.

Commands, contents and scales are those of vedderb/bldc, comm/comm_can.c.  Assumed: commands take
effect at once; currents and duty cycles are not those of a motor, but tell torque from no torque;
the two status rates have random phases; the speed is rounded towards 0, as a cast in C.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING

from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import EXTENDED
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel

if TYPE_CHECKING:
    from thorvaldc.simulation.bus.simulated_device import DeviceSpecification

SET_CURRENT, SET_CURRENT_BRAKE, SET_RPM, STATUS, STATUS_4, STATUS_5 = 1, 2, 3, 9, 16, 27
ALL = 255
"""VESC ID that addresses all VESCs."""
LOOP_PERIOD = 0.005
"""Period (s) in which the timeout is checked; that of a VESC is shorter."""
VESC_ID, TIMEOUT = "vesc_id", "timeout"
"""Keys of the values in non-volatile memory."""


def key(command: int, vesc_id: int) -> int:
    """Returns the key of a message: its identifier has 29 bits."""
    return command << 8 | vesc_id | EXTENDED


class Vesc(SimulatedDevice):
    """A simulated VESC.

    - ``erpm``: speed (rad/s) of the joint for an electrical revolution per minute.
    - ``minimum_erpm``: speed of SET_RPM below which the motor gets no torque.
    """

    def __init__(self, specification: DeviceSpecification) -> None:
        node = specification.node
        memory = {VESC_ID: node.id, TIMEOUT: float(specification.property("timeout"))}
        super().__init__(specification, memory)
        actuator = specification.actuator(node.channels[0].name)
        self.motor: MotorModel = specification.motor_of(actuator)
        gear_ratio = 1.0 if actuator is None else actuator.gear_ratio
        pole_pairs = int(specification.property("pole_pairs"))
        self.erpm = math.tau / 60.0 / (pole_pairs * gear_ratio)
        self.minimum_erpm = float(specification.property("minimum_erpm"))
        self.periods = {
            command: specification.period(key(command, node.id), 0.0)
            for command in (STATUS, STATUS_4, STATUS_5)
        }
        self.encoder = Encoder(1.0, 1024)
        self.has_timeout = True
        self.current = 0.0
        self._fed_at = -math.inf

    # -- start and stop ----------------------------------------------------------------------------

    def start(self) -> None:
        self.has_timeout = True
        self.encoder.set_zero(self.motor.read(self.now))
        self._release()
        self._add_handlers()
        self.every(lambda: LOOP_PERIOD, self._check_timeout, first=LOOP_PERIOD)
        self._repeat(self.periods[STATUS], self._send_status)
        self._repeat(self.periods[STATUS_4], self._send_status_4)
        self._repeat(self.periods[STATUS_5], self._send_status_5)

    def _repeat(self, period: float, send: Callable[[], None]) -> None:
        if period > 0.0:
            self.every(lambda: period, send, first=self.random.uniform(0.0, period))

    def stop(self) -> None:
        self._release()

    def _add_handlers(self) -> None:
        handlers = {
            SET_CURRENT: self._handle_current,
            SET_CURRENT_BRAKE: self._handle_brake,
            SET_RPM: self._handle_rpm,
        }
        self.handlers = {
            key(command, vesc_id): handler
            for command, handler in handlers.items()
            for vesc_id in (int(self.nonvolatile[VESC_ID]), ALL)
        }

    def change_node_id(self, node_id: int) -> None:
        self.nonvolatile[VESC_ID] = node_id
        self._add_handlers()

    def lose_watchdog(self) -> None:
        self.has_timeout = False

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        return self.encoder, self.motor

    # -- commands ----------------------------------------------------------------------------------

    def _release(self) -> None:
        self.current = 0.0
        self.motor.release(self.now)

    def _turn(self, velocity: float) -> None:
        self.current = 1.0
        self.motor.turn(velocity, self.now)

    def _handle_current(self, frame: CanFrame) -> None:
        (milliamperes,) = struct.unpack_from(">i", frame.data)
        self._fed_at = self.now
        if milliamperes == 0:
            self._release()

    def _handle_brake(self, frame: CanFrame) -> None:
        self._fed_at = self.now
        self._turn(0.0)

    def _handle_rpm(self, frame: CanFrame) -> None:
        (erpm,) = struct.unpack_from(">i", frame.data)
        self._fed_at = self.now
        if abs(erpm) < self.minimum_erpm:
            self._release()
        else:
            self._turn(erpm * self.erpm)

    def _check_timeout(self) -> None:
        timeout = self.nonvolatile[TIMEOUT]
        if self.has_timeout and self.now - self._fed_at > timeout:
            self._release()

    # -- reports -----------------------------------------------------------------------------------

    def _report(self, command: int, data: bytes) -> None:
        self.send(key(command, int(self.nonvolatile[VESC_ID])), data)

    def _send_status(self) -> None:
        _, velocity = self.encoder.measure(self.motor.read(self.now))
        erpm = velocity / self.erpm
        whole = int(erpm) if math.isfinite(erpm) else 0
        duty_cycle = 0 if self.current == 0.0 else max(-1000, min(whole // 50, 1000))
        self._report(STATUS, struct.pack(">ihh", whole, round(10 * self.current), duty_cycle))

    def _send_status_4(self) -> None:
        self._report(STATUS_4, struct.pack(">hhhh", 300, 310, 5, 0))

    def _send_status_5(self) -> None:
        angle, _ = self.encoder.measure(self.motor.read(self.now))
        turns = angle / (60.0 * self.erpm)
        self._report(STATUS_5, struct.pack(">ihxx", int(6 * turns), 240))
