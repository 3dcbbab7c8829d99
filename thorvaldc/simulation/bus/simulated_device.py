"""A simulated device: power, time, frames in and out, and what it keeps without power."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.nanoseconds import NANOSECONDS, to_ns
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.timeline import Action, Event
from thorvaldc.simulation.bus.wire import Wire

LATENCY = 100e-6
"""Least time (s) from the end of a frame to a device's reaction; half of it more at random."""
WRITE_TIME = 20e-3
"""Time (s) that a device takes to write what it keeps without power."""
BITRATE = "bitrate"


class SimulatedDevice:
    """What hangs on a wire: subclasses say what it does in ``start`` and with frames.

    Nothing happens before ``power_on``.  Timers, queues and volatile state end with
    the power; ``nonvolatile`` does not.  Reactions come a little after their frame, in the
    order of the frames; the times are drawn from ``seed`` and the name.

    ``handlers`` takes each frame that concerns the device by its identifier (11 bit).
    A device that is ``muted`` hears and acknowledges but sends nothing.
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
        """``bitrate`` (bit/s) at delivery; ``nonvolatile`` may hold another."""
        self.name = name
        self.wire = wire
        self.timeline = wire.timeline
        self.random = random.Random(f"{seed}:{name}")
        self.factory_bitrate = bitrate
        self.nonvolatile: dict[str, Any] = {BITRATE: bitrate, **(nonvolatile or {})}
        self.write_time = WRITE_TIME
        self.torn_writes = False
        self.muted = False
        self.powered = False
        self.handlers: dict[int, Callable[[CanFrame], None]] = {}
        self.controller = CanController(wire, name, bitrate)
        self.controller.on_frame = self._arrived
        wire.attach(self.controller)
        self._life = 0
        self._handled_until = 0
        self._writing: dict[str, Any] = {}

    # -- power ------------------------------------------------------------------------------

    def power_on(self) -> None:
        if self.powered:
            return
        self.powered = True
        # A write that was torn may have lost it.
        self.controller.bitrate = self.nonvolatile.get(BITRATE, self.factory_bitrate)
        self.controller.switch_on()
        self.start()

    def power_off(self) -> None:
        """At once; what is being written is lost, or destroyed where writes are torn."""
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
        """What it does when the power comes."""

    def change_node_id(self, node_id: int) -> None:
        """Have another id all of a sudden.  Raises ``ValueError`` where it has none."""
        raise ValueError(f"{self.name} has no id")

    def change_bitrate(self, bitrate: int) -> None:
        """Go on with another bitrate until the power goes."""
        self.controller.bitrate = bitrate
        self.controller.restart()

    def stop(self) -> None:
        """What follows from the power's loss, for what is moved by the device."""

    # -- time -------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """s"""
        return self.timeline.now / NANOSECONDS

    def after(self, delay: float, action: Action) -> Event:
        """Do it in ``delay`` s, unless the power goes first."""
        life = self._life

        def act() -> None:
            if self._life == life:
                action()

        return self.timeline.after(to_ns(delay), act)

    def every(self, period: Callable[[], float], action: Action, first: float = 0.0) -> None:
        """Do it every ``period()`` s, from ``first`` s on, until the power goes.

        While ``period()`` is not positive it is looked at ten times a second.
        """

        def again() -> None:
            if period() > 0.0:
                action()
            self.after(period() if period() > 0.0 else 0.1, again)

        self.after(first, again)

    # -- frames -----------------------------------------------------------------------------

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame, unless it is muted; a full queue or bus-off loses it."""
        if not self.muted:
            self.controller.send(CanFrame(identifier, data))

    def _arrived(self, frame: CanFrame) -> None:
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

    # -- what it keeps ------------------------------------------------------------------------

    def keep(self, changes: Mapping[str, Any], done: Action | None = None) -> None:
        """Writes to non-volatile memory; calls ``done`` after the write time."""
        self._writing = {**self._writing, **changes}
        wanted = dict(changes)

        def written() -> None:
            self.nonvolatile.update(wanted)
            for key in wanted:
                self._writing.pop(key, None)
            if done is not None:
                done()

        self.after(self.write_time, written)
