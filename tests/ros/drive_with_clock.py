"""Publishes /clock for a node that uses it, and lets the clock stand still and jump."""

from __future__ import annotations

import time

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from tests.ros.client import Client


class ClockClient(Client):
    """A client that publishes the time of /clock while it sends twists."""

    offset = 100.0
    runs = True

    def send(self, vx: float = 0.0, **options: object) -> None:  # type: ignore[override]
        if self.runs:
            now = round((time.monotonic() - START + self.offset) * 1e9)
            stamp = Time(sec=now // 1_000_000_000, nanosec=now % 1_000_000_000)
            if "clock" not in self._publishers:
                self._publishers["clock"] = self.node.create_publisher(Clock, "/clock", 1)
            self._publishers["clock"].publish(Clock(clock=stamp))
        super().send(vx, **options)  # type: ignore[arg-type]


START = time.monotonic()


def main() -> None:
    client = ClockClient()
    client.runs = False
    client.wait("odometry", lambda: "base_raw" in client.last, client.send)
    assert client.switch("enable") == (False, "the clock /clock has not run yet")
    client.runs = True
    client.arm()
    client.drive(0.3)
    client.runs = False
    client.wait("rest", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    assert max(map(abs, client.keep(0.3, 0.3))) < 1e-3
    ok, reason = client.switch("enable")
    assert not ok
    assert reason.startswith("the clock /clock stands still at 1"), reason
    client.runs = True
    # The clock runs again: the held stick does not move the robot before it was at zero.
    assert max(map(abs, client.keep(0.3, 0.4))) < 1e-3
    client.drive(0.3)
    client.offset -= 50.0
    client.wait("rest", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    client.drive(0.3)
    without_the_clock(client)


def without_the_clock(client: ClockClient) -> None:
    """Ends the clock and switches ``use_sim_time`` off and on: the robot drives without it."""
    client.runs = False
    client.wait("rest", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    assert client.set(use_sim_time=False) == ""
    assert max(map(abs, client.keep(0.3, 0.3))) < 1e-3  # the time jumped
    assert client.switch("enable")[0]
    client.drive(0.3)
    assert "clock" not in client.values("commands")
    assert client.set(use_sim_time=True) == ""
    client.wait("rest", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    assert client.switch("enable") == (False, "the clock /clock has not run yet")
    client.runs = True
    client.drive(0.3)


if __name__ == "__main__":
    main()
