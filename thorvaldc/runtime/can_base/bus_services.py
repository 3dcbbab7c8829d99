"""Services that only a robot on CAN buses has, and what an operator is told of the buses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import key_text
from thorvaldc.runtime.base_interface import ComponentStatus, RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState, BaseStateMachine, StateChange
from thorvaldc.runtime.can_base.battery_and_io_drivers import (
    SUPPLY,
    BatterySupervision,
    IoBoardDriver,
)
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.foreign_frame_relay import RelayedFrame
from thorvaldc.runtime.can_base.motor_controller import MotorController
from thorvaldc.runtime.service_table import Service, ServiceError


class BusServices:
    """Requests to the nodes of a robot's buses: settings, outputs, foreign devices.

    Each method raises ``RequestRefused`` if it cannot be executed.  ``standing`` returns ``True``
    if no wheel turns and no wheel is commanded to turn.
    """

    def __init__(self, connections: Sequence[BusConnection], standing: Callable[[], bool]) -> None:
        self._connections = connections
        self._standing = standing

    @property
    def boards(self) -> list[IoBoardDriver]:
        return [board for connection in self._connections for board in connection.boards]

    def set_home_count_current_position_zero(self, node: str = "") -> None:
        """Sets the present steering angles of one or all motor controllers as the zero position.

        ``node`` is the name of a motor controller in the robot file.  An empty name selects all
        motor controllers.  The motor controllers store the new zero position and use the new zero
        position from the next homing on.  Raises ``RequestRefused`` if the robot moves, if a
        selected motor controller is not homed, or if none of the selected motor controllers uses a
        home switch.
        """
        self._require_standing()
        frames = 0
        for connection, controller in self._controllers(node):
            if not controller.homed:
                raise RequestRefused(f"{controller.node.name} is not homed")
            frame = controller.set_zero_frame()
            if frame is not None:
                connection.outbox.append(frame)
                frames += 1
        if not frames:
            raise RequestRefused("none of these controllers counts from a home switch")

    def setup_motor_controller(self, node: str, setting: str, value: float) -> None:
        """Changes a setting of a motor controller.

        - ``node``: name of the motor controller.  An empty name selects all motor controllers.
        - ``setting``: name of a value that the settings frame of the motor controller can change.
        - ``value``: new value in the unit of the motor controller.

        Raises ``RequestRefused`` if the robot moves, or if the name or the value of the setting is
        invalid.
        """
        self._require_standing()
        for connection, controller in self._controllers(node):
            try:
                connection.queue_setting(controller, setting, value)
            except ValueError as error:
                known = ", ".join(controller.setting_names())
                reason = f"{error}; there are {known}" if known else str(error)
                raise RequestRefused(reason) from None

    def mute_devices(self, muted: bool = True) -> None:
        """Stops relaying CAN frames to foreign devices.  ``muted=False`` resumes relaying."""
        for connection in self._connections:
            connection.relay.mute(muted)

    def set_output(self, board: str, output: str, on: bool = True) -> None:
        """Switches an output of an IO board on or off.

        Raises ``RequestRefused`` if the robot has no such IO board or output.
        """
        for connection in self._connections:
            for io_board in connection.boards:
                if io_board.node.name == board:
                    try:
                        connection.outbox.append(io_board.switch(output, on))
                    except KeyError:
                        known = ", ".join(io_board.outputs)
                        reason = f"{board} has no output `{output}`; it has {known}"
                        raise RequestRefused(reason) from None
                    return
        boards = ", ".join(b.node.name for b in self.boards)
        known = f"; there are {boards}" if boards else ""
        raise RequestRefused(f"there is no IO board `{board}`{known}")

    def send_to_device(self, frame: CanFrame, now: float, bus: str = "") -> None:
        """Relays a CAN frame to a foreign device.  An empty ``bus`` selects the first CAN bus.

        Raises ``RequestRefused`` if the bus is unknown or the relay drops the CAN frame, for
        example because the robot file does not allow its CAN id.
        """
        reason = self._connection(bus).relay.offer(frame, now)
        if reason:
            raise RequestRefused(f"{key_text(frame.key)}: {reason}")

    def from_devices(self, bus: str = "") -> list[RelayedFrame]:
        """Returns the CAN frames that foreign devices have sent since the last call."""
        return self._connection(bus).relay.received()

    def relay_drops(self) -> dict[str, int]:
        """Returns the number of CAN frames that the relay dropped, for each CAN id and reason.

        The keys of the returned dictionary are texts such as ``0x240 too often``.
        """
        return {
            f"{key_text(key)} {reason}": number
            for connection in self._connections
            for (key, reason), number in sorted(connection.relay.dropped.items())
        }

    # -- inside --------------------------------------------------------------------------------

    def _controllers(self, node: str) -> list[tuple[BusConnection, MotorController]]:
        """Returns the motor controllers with the name ``node``, each with its bus connection.

        An empty name selects all motor controllers.  Raises ``RequestRefused`` if no motor
        controller has this name.
        """
        every = [(c, controller) for c in self._connections for controller in c.controllers]
        matching = [
            (c, controller) for c, controller in every if node in ("", controller.node.name)
        ]
        if not matching:
            known = ", ".join(controller.node.name for _, controller in every)
            raise RequestRefused(f"there is no controller `{node}`; there are {known}")
        return matching

    def _connection(self, bus: str) -> BusConnection:
        for connection in self._connections:
            if bus in ("", connection.bus.name):
                return connection
        raise RequestRefused(f"there is no bus `{bus}`")

    def _require_standing(self) -> None:
        if not self._standing():
            raise RequestRefused("the robot drives; stop it first")


def bus_services(services: BusServices) -> Iterator[Service]:
    """Yields the services of a robot with CAN buses, for the table of services."""

    def send_to_device(
        now: float, cob_id: int, data: str, bus: str = "", extended: bool = False
    ) -> None:
        try:
            content = bytes.fromhex(data)
        except ValueError:
            raise ServiceError(f"`data` is {data!r}; it must be bytes in hexadecimal") from None
        if len(content) > 8 or not 0 <= cob_id < 1 << (29 if extended else 11):
            raise ServiceError(
                "a frame has an identifier of 11 bits, with `extended` of 29 bits, and at most 8 "
                "bytes"
            )
        services.send_to_device(CanFrame(cob_id, content, extended), now, bus)

    def from_devices(bus: str = "") -> list[dict[str, Any]]:
        return [
            {
                "time": time,
                "cob_id": frame.id,
                "extended": frame.extended,
                "data": frame.data.hex(),
            }
            for time, frame in services.from_devices(bus)
        ]

    yield Service(
        "set_home_count_current_position_zero",
        "Make the present steering angle zero, of one controller or of all.",
        services.set_home_count_current_position_zero,
    )
    yield Service(
        "setup_motor_controller",
        "Write a setting of a motor controller, in its units.",
        services.setup_motor_controller,
    )
    yield Service(
        "mute_devices",
        "Stop relaying frames to foreign devices, or start it again.",
        services.mute_devices,
    )
    yield Service("set_output", "Switch an output of an IO board.", services.set_output)
    yield Service(
        "send_to_device",
        "Relay a frame to a foreign device, `data` in hexadecimal.",
        send_to_device,
    )
    yield Service(
        "from_devices",
        "Return the frames of foreign devices since the last call.",
        from_devices,
    )


# -- reasons against arming, and the state of each part -----------------------------------------
#
# Consequences of a reported reason are not reported: the motors of a stopped robot are never
# enabled.

NEWEST = 5
"""Number of changes of the state that are shown."""


def arming_reasons(
    state_machine: BaseStateMachine, batteries: BatterySupervision, now: float
) -> Iterator[str]:
    """Yields the reasons of the base, of its motor controllers and of its batteries."""
    state = state_machine.state
    if state_machine.ending:
        yield "the driver is shutting down"
    elif state in (BaseState.FAULT, BaseState.ESTOP):
        yield f"the base is {state.value}, reset it first"
    elif state not in (BaseState.STANDBY, BaseState.READY):
        yield f"the base is {state.value}, not ready"
    for connection in state_machine.connections:
        problem = connection.impostor() or connection.problem(now)
        if problem:
            yield problem.text
        yield from connection.suspicious_devices()
        for controller in connection.controllers:
            reason = _controller_reason(controller, state)
            if reason and not (problem and problem.node == controller.node.name):
                yield f"{controller.node.name}: {reason}"
    yield from batteries.arming_reasons(now)


def _controller_reason(controller: MotorController, state: BaseState) -> str:
    if controller.problem or controller.power_loss:
        return controller.problem or controller.power_loss
    if controller.error_code:
        return f"emergency {controller.error_code:#06x}"
    if state is not BaseState.READY:  # the base homes and enables the motors before it is ready
        return ""
    if not controller.homed:
        return "it is not homed"
    follows = controller.follows or not controller.powered
    return "" if follows else "its motors are not enabled"


def component_statuses(
    state_machine: BaseStateMachine,
    batteries: BatterySupervision,
    changes: Sequence[StateChange],
    now: float,
) -> Iterator[ComponentStatus]:
    """Yields the statuses of the states, the buses, the motor controllers and the batteries."""
    newest = [f"{c.time:.2f} s {c.state.value} {c.reason}".strip() for c in changes[-NEWEST:]]
    yield ComponentStatus("states", "ok", state_machine.state.value, {"changes": newest})
    for connection in state_machine.connections:
        yield from _connection_statuses(connection, now)
    for driver in batteries.batteries:
        name, battery = driver.node.name, driver.state
        values = {**battery.source, "alarms": battery.alarms, "temperatures": battery.temperatures}
        reason = batteries.problem(name) or driver.problem
        yield ComponentStatus(name, "warning" if reason else "ok", reason or "ok", values)
    if batteries.has_several and (supply := batteries.supply) is not None:
        level = "warning" if (reason := batteries.problem(SUPPLY)) else "ok"
        yield ComponentStatus(SUPPLY, level, reason or "ok", supply.source)


def measured_load(connection: BusConnection) -> float | None:
    """Returns the load of a bus as a fraction of its bit rate, or ``None`` if it is not known yet.

    The load is at most this: see ``bits_per_second`` of the receiver.
    """
    bits = connection.receiver.bits_per_second
    return None if bits is None else round(bits / connection.bus.bitrate, 4)


def _connection_statuses(connection: BusConnection, now: float) -> Iterator[ComponentStatus]:
    fault = connection.problem(now)
    values: dict[str, Any] = {
        **connection.counters,
        "relayed": connection.relay.passed.total(),
    }
    if (load := measured_load(connection)) is not None:
        values["load"] = load
    level, text = ("error", fault.text) if fault else ("ok", "ok")
    yield ComponentStatus(f"bus {connection.bus.name}", level, text, values)
    for controller in connection.controllers:
        problem = controller.problem or controller.power_loss
        values = {
            "homed": controller.homed,
            "follows": controller.follows,
            "error_code": f"{controller.error_code:#06x}",
        }
        level = "error" if problem or controller.error_code else "ok"
        yield ComponentStatus(controller.node.name, level, problem or "ok", values)
