"""The simulated bus as an interface of python-can: ``thorvaldc_sim``.

    bus = can.Bus(interface="thorvaldc_sim", channel="thorvald_4wd4ws")

The channel is the name that ``thorvaldc bus`` prints, or the path of its socket; or, in
the same process and in virtual time, a ``Wire``.  Where thorvaldc is installed python-can
finds the interface by itself; elsewhere ``register()`` makes it known.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import can
import can.interfaces
import can.util

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.simulation.bus.timeline import Event
from thorvaldc.simulation.bus.virtual_time_interface import VirtualTimeInterface
from thorvaldc.simulation.bus.wire import Wire

NAME = "thorvaldc_sim"
PATIENCE = 1.0
"""s that a send without a time-out waits for room: canopen's scanner sends 127 frames at once."""
_STATES = {
    ErrorState.ACTIVE: can.BusState.ACTIVE,
    ErrorState.PASSIVE: can.BusState.PASSIVE,
    ErrorState.BUS_OFF: can.BusState.ERROR,
}


def register() -> None:
    """Make ``can.Bus(interface="thorvaldc_sim")`` work where thorvaldc is not installed."""
    can.interfaces.BACKENDS[NAME] = (__name__, SimulatedBus.__name__)
    known = frozenset((*can.interfaces.VALID_INTERFACES, NAME))
    # python-can takes the names at its import, in three places.
    for module in (can, can.interfaces, can.util):
        vars(module)["VALID_INTERFACES"] = known


class SimulatedBus(can.BusABC):
    """A program's place on a simulated wire.

    On a ``Wire`` time is virtual: it runs while the program waits in ``recv`` or
    ``send``, and only then; one thread, the same in every run.  On a channel of another
    process it goes by the clock, or with ``lockstep`` by the waits of all clients in
    lockstep.  Time-outs and timestamps are in s of that time.

    ``port`` is the client below, for what python-can has no words for: ``now``,
    ``sleep``, ``sleep_until``, ``overruns``.
    """

    def __init__(
        self,
        channel: str | Wire,
        *,
        bitrate: int | None = None,
        name: str = "python-can",
        receive_own_messages: bool = False,
        listen_only: bool = False,
        lockstep: bool = False,
        fifo: bool = False,
        can_filters: Any = None,
        **_: Any,
    ) -> None:
        """``bitrate`` (bit/s) ``None``: that of the wire.

        Raises ``can.CanInitializationError`` where there is no such bus.
        """
        options: dict[str, Any] = {
            "receive_own": receive_own_messages,
            "listen_only": listen_only,
            "fifo": fifo,
        }
        self.port: VirtualTimeInterface | SimulatedBusClient
        try:
            if isinstance(channel, Wire):
                self.port = VirtualTimeInterface(channel, name, bitrate, **options)
            else:
                self.port = SimulatedBusClient(
                    str(channel), name, bitrate, lockstep=lockstep, **options
                )
        except OSError as fault:
            # BusABC warns of a bus that was not shut down; there is none.
            self._is_shutdown = True
            raise can.CanInitializationError(str(fault)) from None
        self.channel_info = f"{NAME} {channel if isinstance(channel, str) else name}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=str(channel), can_filters=can_filters)

    @property
    def state(self) -> can.BusState:
        return _STATES[self.port.state]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        """``ACTIVE``: come back from bus-off, which does not happen by itself."""
        if new_state is not can.BusState.ACTIVE:
            raise NotImplementedError("only ACTIVE can be asked for")
        self.port.restart()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """As of python-can: ``CanOperationError`` where the queue stays full or the bus is off.

        ``timeout`` in s, ``None``: ``PATIENCE``.
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
            taken = self.port.send(frame, PATIENCE if timeout is None else timeout)
        except ConnectionError as fault:
            raise can.CanOperationError(str(fault)) from None
        if not taken:
            off = self.port.state is ErrorState.BUS_OFF
            raise can.CanOperationError("bus-off" if off else "the transmit queue is full")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As of python-can, in the time of the bus."""
        limit = None if timeout is None else self.port.now + timeout
        while True:
            left = None if limit is None else max(limit - self.port.now, 0.0)
            try:
                found = self.port.receive(left)
            except ConnectionError as fault:
                raise can.CanOperationError(str(fault)) from None
            if found is None:
                return None
            message = self._message(found)
            if self._matches_filters(message):
                return message

    def _message(self, found: ReceivedFrame) -> can.Message:
        frame = found.frame
        return can.Message(
            timestamp=self.port.epoch + found.time / 1e9,
            arbitration_id=frame.id,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            dlc=frame.length,
            data=None if frame.remote else frame.data,
            is_rx=not found.own,
            channel=self.channel_info,
        )

    def _apply_filters(self, filters: Any) -> None:
        """Filters are applied where messages are received."""

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> Any:
        if isinstance(self.port, SimulatedBusClient):
            return super()._send_periodic_internal(
                msgs, period, duration, autostart, modifier_callback
            )
        task = VirtualCyclicTask(self, self.port, msgs, period, duration, modifier_callback)
        if autostart:
            task.start()
        return task

    def shutdown(self) -> None:
        if not self._is_shutdown:
            super().shutdown()
            self.port.close()


class VirtualCyclicTask(
    can.broadcastmanager.LimitedDurationCyclicSendTaskABC,
    can.broadcastmanager.ModifiableCyclicTaskABC,
    can.broadcastmanager.RestartableCyclicTaskABC,
):
    """Sends again and again in virtual time; a frame that finds no room is left out."""

    def __init__(
        self,
        bus: SimulatedBus,
        port: VirtualTimeInterface,
        messages: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None,
        modifier: Callable[[can.Message], None] | None,
    ) -> None:
        super().__init__(messages, period, duration)
        self._bus = bus
        self._timeline = port.timeline
        self._modifier = modifier
        self._event: Event | None = None
        self._next = 0
        self._until: int | None = None

    def start(self) -> None:
        self.stop()
        now = self._timeline.now
        self._until = None if self.duration is None else now + to_ns(self.duration)
        self._event = self._timeline.at(now, self._act)

    def stop(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None

    def _act(self) -> None:
        if self._until is not None and self._timeline.now >= self._until:
            return
        message = self.messages[self._next % len(self.messages)]
        self._next += 1
        if self._modifier is not None:
            self._modifier(message)
        with contextlib.suppress(can.CanOperationError):
            self._bus.send(message, timeout=0.0)
        self._event = self._timeline.after(to_ns(self.period), self._act)
