"""A client of the control channel, as a person or another program uses it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from tests.chaos.control_streams import MemoryStream
from thorvaldc.runtime.se2 import Twist

if TYPE_CHECKING:
    from tests.chaos.chaos_world import ChaosWorld


class ChaosClient:
    """A program that is connected to the control channel of the driver."""

    def __init__(self, world: ChaosWorld, name: str) -> None:
        self.world = world
        self.name = name
        self.stream: MemoryStream | None = None
        self.connection = ""
        self.reads = True
        self.floods = False
        """``True`` if the connection has sent more requests than the driver reads in a cycle."""
        self._connections = 0
        self._driving = 0

    def connect(self) -> None:
        self.close()
        world = self.world
        if world.listener is None:
            return
        self._connections += 1
        self.floods = False
        self.connection = f"{self.name}#{self._connections}"
        self.stream = MemoryStream()
        world.listener.waiting.append(self.stream)
        world.permission.connects(self.connection)

    def close(self) -> None:
        """Ends, as a program that is killed."""
        self._driving += 1
        if self.stream is not None:
            self.stream.client_gone = True
            self.stream = None
            self.world.permission.disconnects(self.connection)

    def notice_end(self) -> None:
        """Notices that the driver has closed the connection, for example after a flood."""
        if self.stream is not None and self.stream.closed:
            self.stream = None
            self.world.permission.disconnects(self.connection)

    def hang(self) -> None:
        """Sends nothing more, but keeps the connection."""
        self._driving += 1
        self.reads = False

    def send(self, data: bytes) -> bool:
        """Sends bytes; returns ``False`` if the connection is closed or full."""
        if self.stream is None or self.stream.closed:
            self.connect()
        if self.stream is None:
            return False
        before = len(self.stream.to_driver)
        self.stream.client_send(data)
        if self.reads:
            self.stream.client_read()
        return len(self.stream.to_driver) - before == len(data)

    def call(self, service: str, arguments: dict[str, Any]) -> None:
        line = json.dumps({"call": service, "arguments": arguments}).encode() + b"\n"
        if not self.send(line):
            return
        if service == "twist" and self.floods and not any(map(arguments.get, ("vx", "vy", "wz"))):
            # The zero may wait behind the flood, and the last motion then ends with its time-out.
            self.world.permission.sends_late_zero(str(arguments["source"]), self.world.now)
            return
        self.tell(service, arguments)

    def tell(self, service: str, arguments: dict[str, Any]) -> None:
        """Tells the judge what was sent."""
        permission, now = self.world.permission, self.world.now
        if service == "twist":
            parts = [arguments.get(name, 0.0) for name in ("vx", "vy", "wz")]
            if all(isinstance(part, int | float) for part in parts):
                source = str(arguments.get("source"))
                permission.sends_twist(self.connection, source, Twist(*parts), now)
        else:
            permission.calls(self.connection, service, arguments, now)

    def drive(
        self, source: str, twist: list[float], seconds: float, rate: float, held: bool = False
    ) -> None:
        """Sends zero, then a twist periodically, and zero at the end.

        ``held``: ``True`` for a stick that is held from the start, without the first zero.
        """
        self._driving += 1
        number, end = self._driving, self.world.now + seconds
        vx, vy, wz = twist

        def send() -> None:
            if self._driving != number:
                return
            if self.world.now >= end:
                self.call("twist", {"source": source})
                return
            self.call("twist", {"source": source, "vx": vx, "vy": vy, "wz": wz})
            self.world.after(1.0 / rate, send)

        if not held:
            self.call("twist", {"source": source})
            self.world.after(1.0 / rate, send)
        else:
            send()
