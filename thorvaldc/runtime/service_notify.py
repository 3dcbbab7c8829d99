"""Tells systemd that the base driver runs, and that its control cycles go on (sd_notify(3)).

A service of the type `notify` with `WatchdogSec` ends a process that sends no `WATCHDOG=1` in time.
The control loop itself sends it, so that a loop that hangs is noticed although other threads run.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

SHARE = 0.25
"""Time between two messages by the time after which systemd ends the process."""


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
