"""A serial CAN adapter (Lawicel protocol) between a pseudo-terminal and a simulated bus."""

from __future__ import annotations

import os
import pty
import time
import tty
from collections.abc import Callable

from thorvaldc.can.frame import CanFrame
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

LONGEST_STEP = 0.02  # s


class SlcanAdapter:
    """Another process opens ``path``; ``serve`` passes frames on in real time."""

    def __init__(self, simulated: SimulatedRobot) -> None:
        self.simulated = simulated
        self.client = simulated.interface(name="adapter", fifo=True)
        self.ours, self.theirs = pty.openpty()
        for end in (self.ours, self.theirs):
            tty.setraw(end)
        os.set_blocking(self.ours, False)
        self.path = os.ttyname(self.theirs)
        self.open = False
        self.commands: list[str] = []
        self._incomplete = b""
        self._unwritten = b""

    def serve(self, until: Callable[[], bool], limit: float) -> None:
        """Passes frames on until ``until()`` is true, for at most ``limit`` s.

        The time of the bus goes on with the real time, but by a short step only after this process
        was not served: else the watchdogs of the drives would act, as they should.
        """
        last = time.monotonic()
        end = last + limit
        while not until() and last < end:
            self._read_serial()
            elapsed, last = time.monotonic() - last, time.monotonic()
            self.client.sleep_until(self.simulated.timeline.seconds + min(elapsed, LONGEST_STEP))
            self._write_serial()
            time.sleep(0.001)

    def _read_serial(self) -> None:
        try:
            data = os.read(self.ours, 65536)
        except BlockingIOError:
            return
        *lines, self._incomplete = (self._incomplete + data).split(b"\r")
        for line in lines:
            text = line.decode()
            if text[:1] == "t" and self.open:
                length = int(text[4])
                data = bytes.fromhex(text[5 : 5 + 2 * length])
                self._send(CanFrame(int(text[1:4], 16), data))
            elif text:
                self.commands.append(text)
                self.open = text == "O" if text in ("O", "C") else self.open

    def _send(self, frame: CanFrame) -> None:
        """Sends a frame; a busy machine passes many frames on at once, for which the bus needs
        time."""
        for _ in range(200):
            if self.client.send(frame):
                return
            self.client.sleep(0.001)
        raise AssertionError("the simulated bus accepts no frame for 0.2 s")

    def _write_serial(self) -> None:
        lines = self._unwritten
        while (received := self.client.receive(0.0)) is not None:
            frame = received.frame
            lines += f"t{frame.id:03X}{len(frame.data)}{frame.data.hex().upper()}\r".encode()
        self._unwritten = b""
        if lines and self.open:
            try:
                written = os.write(self.ours, lines)
            except BlockingIOError:  # a busy machine has not read what was written before
                written = 0
            self._unwritten = lines[written:]

    def close(self) -> None:
        os.close(self.ours)
        os.close(self.theirs)
