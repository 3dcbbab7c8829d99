"""The base class of simulated devices: power, timers, frames and non-volatile memory."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.nanoseconds import NANOSECONDS, to_ns
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel
from thorvaldc.simulation.bus.timeline import Action, Event
from thorvaldc.simulation.bus.wire import Wire

if TYPE_CHECKING:
    from typing import Self

    from thorvaldc.simulation.bus.device_specification import DeviceSpecification

LATENCY = 100e-6
"""Shortest time (s) from the end of a frame to a device's reaction; up to half of it is added."""
WRITE_TIME = 20e-3
"""Duration (s) of a write to non-volatile memory."""
BITRATE = "bitrate"
"""Key of the bitrate (bit/s) in non-volatile memory."""


class SimulatedDevice:
    """A device on a wire.  A subclass implements ``start`` and adds frame handlers there.

    ``handlers`` maps an 11-bit identifier to the function that handles its frames.  A device
    reacts shortly after a frame, and in the order of the frames; ``seed`` and ``name``
    determine the delays.

    A device does nothing before ``power_on``.  A loss of power ends its timers, its queue and its
    volatile state; ``nonvolatile`` remains.  A ``muted`` device receives and acknowledges
    frames but sends none.

    A class of another package is found by the entry-point group ``thorvaldc.simulated_devices``,
    under the name of the node's protocol.
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        *,
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        """``bitrate`` (bit/s) is the factory setting; ``nonvolatile`` may contain another."""
        self.name = name
        self.wire = wire
        self.timeline = wire.timeline
        self.random = random.Random(f"{seed}:{name}")
        self.factory_bitrate = bitrate
        self.nonvolatile: dict[str, Any] = {BITRATE: bitrate, **(nonvolatile or {})}
        self.write_time = WRITE_TIME
        self.torn_writes = False
        """A loss of power during a write destroys the values being written."""
        self.muted = False
        self.powered = False
        self.handlers: dict[int, Callable[[CanFrame], None]] = {}
        self.controller = CanController(wire, name, bitrate)
        self.controller.on_frame = self._schedule_handler
        wire.attach(self.controller)
        self._life = 0
        """Counts starts; timers of an earlier one do nothing."""
        self._handled_until = 0
        self._writing: dict[str, Any] = {}

    @classmethod
    def from_specification(cls, specification: DeviceSpecification) -> Self:
        """Makes the device of a node.  A subclass with other arguments overrides this method."""
        return cls(
            specification.name,
            specification.wire,
            specification.bus.bitrate,
            **specification.common(),
        )

    # -- power ------------------------------------------------------------------------------

    def power_on(self) -> None:
        if self.powered:
            return
        self.powered = True
        # A torn write may have destroyed the stored bitrate.
        self.controller.bitrate = self.nonvolatile.get(BITRATE, self.factory_bitrate)
        self.controller.switch_on()
        self.start()

    def power_off(self) -> None:
        """Cuts the power.  Values being written are lost, or destroyed with ``torn_writes``."""
        if not self.powered:
            return
        self.powered = False
        self._life += 1
        if self.torn_writes:
            for key in self._writing:
                self.nonvolatile.pop(key, None)
        self._writing = {}
        self.handlers = {}
        self.controller.switch_off()
        self.stop()

    def start(self) -> None:
        """Called after power-on: add handlers and start timers here."""

    def stop(self) -> None:
        """Called after a loss of power: switch motors and outputs off here."""

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        """Returns encoder and motor of a channel, which injected faults freeze or block."""
        return None, None

    def change_node_id(self, node_id: int) -> None:
        """Changes the id, as the maker's tool or a fault does.

        Raises ``ValueError`` for a device without an id.
        """
        raise ValueError(f"{self.name} has no id")

    def change_bitrate(self, bitrate: int) -> None:
        """Changes the bitrate (bit/s) until the next power-on."""
        self.controller.bitrate = bitrate
        self.controller.restart()

    # -- time -------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """s"""
        return self.timeline.now / NANOSECONDS

    def after(self, delay: float, action: Action) -> Event:
        """Calls ``action`` in ``delay`` s, unless the power is lost before."""
        life = self._life

        def act() -> None:
            if self._life == life:
                action()

        return self.timeline.after(to_ns(delay), act)

    def every(self, period: Callable[[], float], action: Action, first: float = 0.0) -> None:
        """Calls ``action`` every ``period()`` s, for the first time in ``first`` s.

        Ends with a loss of power.  ``period()`` may change; while it is not positive, the
        action pauses and the period is checked every 0.1 s.
        """

        def repeat() -> None:
            if period() > 0.0:
                action()
            self.after(period() if period() > 0.0 else 0.1, repeat)

        self.after(first, repeat)

    # -- frames -----------------------------------------------------------------------------

    def send(self, identifier: int, data: bytes) -> None:
        """Sends a frame, unless the device is muted.  A full queue or bus-off drops it."""
        if not self.muted:
            self.controller.send(CanFrame(identifier, data))

    def _schedule_handler(self, frame: CanFrame) -> None:
        if frame.extended or frame.remote or frame.id not in self.handlers:
            return
        life = self._life
        delay = LATENCY * (1.0 + self.random.random() / 2.0)
        self._handled_until = max(self.timeline.now + to_ns(delay), self._handled_until)

        def handle() -> None:
            handler = self.handlers.get(frame.id)
            if handler is not None and self._life == life:
                handler(frame)

        self.timeline.at(self._handled_until, handle)

    # -- non-volatile memory -------------------------------------------------------------------

    def store(self, changes: Mapping[str, Any], on_stored: Action | None = None) -> None:
        """Writes to ``nonvolatile`` after the write time, and then calls ``on_stored``."""
        self._writing = {**self._writing, **changes}
        values = dict(changes)

        def finish() -> None:
            self.nonvolatile.update(values)
            for key in values:
                self._writing.pop(key, None)
            if on_stored is not None:
                on_stored()

        self.after(self.write_time, finish)
