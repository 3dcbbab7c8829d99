"""Tells systemd that the control cycles of the base driver go on, and that the battery is empty.

A service of the type `notify` with `WatchdogSec` ends a process that sends no `WATCHDOG=1` in time
(sd_notify(3)).  The control loop itself sends it, so that a loop that hangs is noticed although
other threads run.  A unit of the type `path` switches the computer off when a file is there.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
from collections.abc import Mapping
from pathlib import Path

from thorvaldc.model import Robot
from thorvaldc.model.robot_computer import POWER_OFF
from thorvaldc.runtime.driven_robot import DrivenRobot

SHARE = 0.25
"""Time between two messages by the time after which systemd ends the process."""
LOW_TIME = 60.0
"""Time (s) for which a battery is low, and not charged, before the computer is switched off."""


class ServiceNotifier:
    """Messages to the service manager that has started this process; none without one."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """Reads the socket and the time (us) from the variables that systemd sets."""
        address = environment.get("NOTIFY_SOCKET", "")
        usec = environment.get("WATCHDOG_USEC", "")
        self._stream: socket.socket | None = None
        self._period = SHARE * int(usec) / 1e6 if usec.isdecimal() else float("inf")
        self._next = float("-inf")
        self._is_ready = False
        # A process that this one starts is no part of the service.
        is_own = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        if address[:1] in ("/", "@") and is_own:
            self._stream = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._stream.setblocking(False)
            with contextlib.suppress(OSError):
                self._stream.connect("\0" + address[1:] if address[0] == "@" else address)

    def cycle_done(self, now: float) -> None:
        """Reports a control cycle at the time ``now`` (s) of a clock that only increases."""
        if self._stream is None or now < self._next:
            return
        self._next = now + self._period
        self._send("WATCHDOG=1" if self._is_ready else "READY=1\nWATCHDOG=1")
        self._is_ready = True

    def close(self) -> None:
        """Reports the end of the process."""
        if self._stream is not None:
            self._send("STOPPING=1")
            self._stream.close()
            self._stream = None

    def _send(self, message: str) -> None:
        # A full or closed socket must not stop the robot; systemd counts the missing message.
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.send(message.encode())


class LowBattery:
    """Asks systemd to switch the computer off before the battery cuts its power (``power_off``)."""

    def __init__(self, robot: Robot, environment: Mapping[str, str] = os.environ) -> None:
        """Reads the runtime directory from the variable that systemd sets."""
        folder, computer = environment.get("RUNTIME_DIRECTORY", ""), robot.computer
        self._limit = computer.power_off if computer is not None and folder else 0.0
        self._file = Path(folder, POWER_OFF)
        self._low_since = math.inf

    def cycle_done(self, driven: DrivenRobot) -> None:
        """Looks at the batteries after a control cycle.

        The robot is disarmed, so that it stands after ``LOW_TIME``; a battery that is silent, or
        that is charged, is not low.
        """
        if self._limit == 0.0:
            return
        now = driven.now
        is_low = not driven.armed and any(
            source.charge < self._limit
            and not source.current < 0.0
            and now - source.time < LOW_TIME
            for source in driven.base.sources()
        )
        self._low_since = min(self._low_since, now) if is_low else math.inf
        if now - self._low_since >= LOW_TIME:
            self._low_since = now  # asks again if nothing happens
            driven.note("the computer is switched off: the battery is empty")
            with contextlib.suppress(OSError):  # a full disk must not stop the robot
                self._file.touch()
