"""Drives a node and ends it: ``drive_to_the_end PROCESS_OF_THE_NODE SIGNAL PAUSE``.

All other signals follow after a pause (s), in which the stop has begun but not ended.  The last
odometry that the program receives must be that of a robot at rest.
"""

from __future__ import annotations

import os
import signal
import sys
import time

from rclpy.qos import QoSProfile

from tests.ros.client import Client, Odometry

SPEED = 0.5


def main() -> None:
    process, first, pause = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    client = Client()
    last: list[float] = []

    def keep(message: Odometry) -> None:
        last[:] = [message.twist.twist.linear.x]

    client.node.create_subscription(Odometry, "odometry/base_raw", keep, QoSProfile(depth=10))
    client.wait("ready", lambda: client.status() == "waiting: disarmed")
    client.arm()
    client.drive(SPEED)
    os.kill(process, first)
    time.sleep(pause)
    for other in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, first):
        os.kill(process, other)  # must not cut off the stop
    seen = client.counts["base_raw"], time.monotonic()
    while time.monotonic() < seen[1] + 1.0:
        client.send(SPEED)
        client.spin()
        if client.counts["base_raw"] > seen[0]:
            seen = client.counts["base_raw"], time.monotonic()
    assert abs(last[0]) < 1e-3, last


if __name__ == "__main__":
    main()
