"""Drives ``/r2`` in MuJoCo whose time is that of another node.

This program publishes ``/clock``, as the first robot of a fleet.
"""

from __future__ import annotations

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from tests.ros.client import Client

STEP = 0.02
"""Time (s) between two messages of the clock: the control cycle of a robot."""


class ClockClient(Client):
    """A client whose commands let the time of ``/clock`` go on by one control cycle each, if the
    robot is not far behind."""

    now = 100.0

    def send(self, vx: float = 0.0, **options: object) -> None:  # type: ignore[override]
        if "base_raw" not in self.last or self.now - pose(self)[0] < 2.5 * STEP:
            self.now += STEP
        nanoseconds = round(self.now * 1e9)
        stamp = Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)
        self.publish("/clock", Clock(clock=stamp))
        super().send(vx, **options)  # type: ignore[arg-type]


def pose(client: Client) -> tuple[float, float]:
    """Returns the time (s) of the newest odometry and the position (m) of the robot."""
    odometry = client.last["base_raw"]
    stamp = odometry.header.stamp
    return stamp.sec + 1e-9 * stamp.nanosec, odometry.pose.pose.position.x


def main() -> None:
    client = ClockClient("/r2")
    kinds = {"base_raw", "joint_states"}
    client.wait("messages", lambda: kinds <= set(client.last), client.send)
    odometry = client.last["base_raw"]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("r2/odom", "r2/base_link")
    assert client.last["joint_states"].name[0].startswith("r2/")
    client.arm()
    client.drive(0.3)
    # The robot moves in the time of the clock, whatever the real time is.
    before = pose(client)
    passed = lambda: pose(client)[0] - before[0] > 1.0  # noqa: E731
    client.wait("1 s of the clock", passed, lambda: client.send(0.3))
    after = pose(client)
    speed = (after[1] - before[1]) / (after[0] - before[0])
    assert abs(speed - 0.3) < 0.03, speed
    # It stands as the clock does, and does not go on by itself afterwards.
    client.spin(1.0)
    stopped = pose(client)
    client.spin(0.5)
    assert pose(client) == stopped
    for _ in range(100):
        client.send(0.3)
        client.spin(0.01)
    client.rest()
    client.drive(0.3)
    # The clock starts again: the robot stops, and drives on in the new time.
    client.now = 1.0
    client.last.pop("base_raw")
    client.wait("rest", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    client.drive(0.3)


if __name__ == "__main__":
    main()
