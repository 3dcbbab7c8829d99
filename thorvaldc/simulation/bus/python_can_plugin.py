"""Connects programs that use python-can to a simulated bus.

Example with the python-can interface ``thorvaldc_sim``:

    bus = can.Bus(interface="thorvaldc_sim", channel="thorvald_4wd4ws")

The argument ``channel`` is the name that ``thorvaldc bus`` prints, or the path of the local socket.
In virtual time, a program in the same process as the simulation passes a ``Wire`` as the argument
``channel``.  If thorvaldc is installed, python-can finds the interface by an entry point.  If
thorvaldc is not installed, call ``register()`` first.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import can
import can.interfaces
import can.util

from thorvaldc.can.frame import CanFrame, ErrorState, ReceivedFrame, to_ns
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Event
from thorvaldc.simulation.bus.wire import Wire

NAME = "thorvaldc_sim"
SEND_TIMEOUT = 1.0
"""Default time-out of ``send`` (s), long enough for the canopen scanner, which sends 127 frames."""
_STATES = {
    ErrorState.ACTIVE: can.BusState.ACTIVE,
    ErrorState.PASSIVE: can.BusState.PASSIVE,
    ErrorState.BUS_OFF: can.BusState.ERROR,
}


def register() -> None:
    """Registers the interface ``thorvaldc_sim`` in python-can.

    A program must call ``register`` only if thorvaldc is not installed as a package.
    """
    can.interfaces.BACKENDS[NAME] = (__name__, SimulatedBus.__name__)
    known = frozenset((*can.interfaces.VALID_INTERFACES, NAME))
    # On import, python-can copies the names of all interfaces into three modules.
    for module in (can, can.interfaces, can.util):
        vars(module)["VALID_INTERFACES"] = known


class SimulatedBus(can.BusABC):
    """A python-can bus that is connected to a simulated CAN bus.

    If the argument ``channel`` is a ``Wire``, the python-can bus runs in virtual time.  Virtual
    time advances only while the program waits in ``recv`` or ``send``.  In virtual time, the
    program must use one thread, and every run has the same result.  If the argument ``channel``
    names a simulated bus in another process, the python-can bus runs in real time.  Time-outs and
    timestamps are in s of the simulated time.

    The attribute ``interface`` has additional functions that python-can does not have: ``now``,
    ``sleep``, ``sleep_until`` and ``overruns``.
    """

    def __init__(
        self,
        channel: str | Wire,
        *,
        bitrate: int | None = None,
        name: str = "python-can",
        receive_own_messages: bool = False,
        listen_only: bool = False,
        fifo: bool = False,
        can_filters: Any = None,
        **_: Any,
    ) -> None:
        """Opens the connection to a simulated bus.

        ``bitrate`` is the bitrate of the CAN controller (bit/s), by default the bitrate of the
        simulated bus.  Raises ``can.CanInitializationError`` if the simulated bus does not exist.
        """
        options: dict[str, Any] = {
            "receive_own": receive_own_messages,
            "listen_only": listen_only,
            "fifo": fifo,
        }
        self.interface: VirtualTimeInterface | SimulatedBusClient
        try:
            if isinstance(channel, Wire):
                self.interface = VirtualTimeInterface(channel, name, bitrate, **options)
            else:
                self.interface = SimulatedBusClient(str(channel), name, bitrate, **options)
        except OSError as error:
            # The python-can class BusABC prints a warning if a bus is not marked as shut down.
            self._is_shutdown = True
            raise can.CanInitializationError(str(error)) from None
        self.channel_info = f"{NAME} {channel if isinstance(channel, str) else name}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=str(channel), can_filters=can_filters)

    @property
    def state(self) -> can.BusState:
        return _STATES[self.interface.state]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        """Leaves bus-off if ``new_state`` is ``ACTIVE``.

        The CAN controller never leaves bus-off automatically.
        """
        if new_state is not can.BusState.ACTIVE:
            raise NotImplementedError("only ACTIVE can be set")
        self.interface.restart()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends a message.

        ``timeout`` is the longest time (s) to wait for space in the send queue.  The default
        time-out is ``SEND_TIMEOUT``.  Raises ``can.CanOperationError`` if the CAN controller is in
        bus-off, or if the send queue is still full after the time-out.
        """
        if msg.is_fd or msg.is_error_frame:
            raise can.CanOperationError("the simulated bus takes classical data and remote frames")
        frame = CanFrame(
            msg.arbitration_id,
            b"" if msg.is_remote_frame else bytes(msg.data),
            msg.is_extended_id,
            msg.is_remote_frame,
            msg.dlc if msg.is_remote_frame else 0,
        )
        try:
            queued = self.interface.send(frame, SEND_TIMEOUT if timeout is None else timeout)
        except ConnectionError as error:
            raise can.CanOperationError(str(error)) from None
        if not queued:
            off = self.interface.state is ErrorState.BUS_OFF
            raise can.CanOperationError("bus-off" if off else "the transmit queue is full")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Receives a message.

        ``timeout`` is the longest time (s) to wait for a message, in the time of the simulated bus.
        """
        limit = None if timeout is None else self.interface.now + timeout
        while True:
            left = None if limit is None else max(limit - self.interface.now, 0.0)
            try:
                received = self.interface.receive(left)
            except ConnectionError as error:
                raise can.CanOperationError(str(error)) from None
            if received is None:
                return None
            message = self._message(received)
            if self._matches_filters(message):
                return message

    def _message(self, received: ReceivedFrame) -> can.Message:
        frame = received.frame
        return can.Message(
            timestamp=self.interface.epoch + received.time / 1e9,
            arbitration_id=frame.id,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            dlc=frame.length,
            data=None if frame.remote else frame.data,
            is_rx=not received.own,
            channel=self.channel_info,
        )

    def _apply_filters(self, filters: Any) -> None:
        """Does nothing, because the method ``recv`` applies the message filters."""

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> Any:
        if isinstance(self.interface, SimulatedBusClient):
            return super()._send_periodic_internal(
                msgs, period, duration, autostart, modifier_callback
            )
        task = VirtualCyclicTask(self, self.interface, msgs, period, duration, modifier_callback)
        if autostart:
            task.start()
        return task

    def shutdown(self) -> None:
        if not self._is_shutdown:
            super().shutdown()
            self.interface.close()


class VirtualCyclicTask(
    can.broadcastmanager.LimitedDurationCyclicSendTaskABC,
    can.broadcastmanager.ModifiableCyclicTaskABC,
    can.broadcastmanager.RestartableCyclicTaskABC,
):
    """Sends messages periodically in virtual time.

    A periodic message is dropped if the send queue is full.
    """

    def __init__(
        self,
        bus: SimulatedBus,
        interface: VirtualTimeInterface,
        messages: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None,
        modifier: Callable[[can.Message], None] | None,
    ) -> None:
        super().__init__(messages, period, duration)
        self._bus = bus
        self._timeline = interface.timeline
        self._modifier = modifier
        self._event: Event | None = None
        self._next_message = 0
        self._until: int | None = None

    def start(self) -> None:
        self.stop()
        now = self._timeline.now
        self._until = None if self.duration is None else now + to_ns(self.duration)
        self._event = self._timeline.at(now, self._send_next)

    def stop(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None

    def _send_next(self) -> None:
        if self._until is not None and self._timeline.now >= self._until:
            return
        message = self.messages[self._next_message % len(self.messages)]
        self._next_message += 1
        if self._modifier is not None:
            self._modifier(message)
        with contextlib.suppress(can.CanOperationError):
            self._bus.send(message, timeout=0.0)
        self._event = self._timeline.after(to_ns(self.period), self._send_next)
