"""Ends the base driver of a driving robot, and measures until the robot is at rest in the engine.

``python -m tests.ros.engines.kill PROCESS SIGNAL`` prints the time (s) of the engine and the
distance (m) from the signal to rest; after 5 s it gives up.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys

from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter

from tests.ros.client import Client

SPEED = 0.5  # m/s
LONGEST = 5.0  # s


def main() -> None:
    process, number = int(sys.argv[1]), int(sys.argv[2])
    client = Client()
    client.node.set_parameters([Parameter("use_sim_time", value=True)])
    client.listen(Odometry, "/odometry/true")
    client.wait("odometry", lambda: {"base_raw", "true"} <= client.last.keys())
    client.arm()
    client.drive(SPEED)
    client.keep(SPEED, 0.5)
    start = client.last["true"]
    os.kill(process, number)
    while abs(speed(client)) > 0.01 and seconds(client) - stamp(start) < LONGEST:
        client.spin(0.01)
    end = client.last["true"].pose.pose.position
    begin = start.pose.pose.position
    result = {
        "time": seconds(client) - stamp(start),
        "distance": math.hypot(end.x - begin.x, end.y - begin.y),
        "speed": speed(client),
    }
    if number == signal.SIGSTOP:
        os.kill(process, signal.SIGCONT)
        client.wait("a fault", lambda: client.status().startswith("no control cycle for"))
    print(json.dumps(result))


def speed(client: Client) -> float:
    return float(client.last["true"].twist.twist.linear.x)


def stamp(message: Odometry) -> float:
    return float(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)


def seconds(client: Client) -> float:
    return stamp(client.last["true"])


if __name__ == "__main__":
    main()
