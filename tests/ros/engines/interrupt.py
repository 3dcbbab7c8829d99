"""Pauses and resets the engine of a driving robot, whose driver gets twists all the time.

``python -m tests.ros.engines.interrupt`` prints the true speed (m/s) 1.5 s after the pause and
after the reset, and the faults of the driver there.
"""

from __future__ import annotations

import json
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from std_msgs.msg import String

from tests.ros.client import Client
from tests.ros.engines.kill import seconds, speed

SPEED = 0.5  # m/s


def main() -> None:
    client = Client()
    client.node.set_parameters([Parameter("use_sim_time", value=True)])
    client.listen(Odometry, "/odometry/true")
    client.wait("odometry", lambda: {"base_raw", "true"} <= client.last.keys())
    client.arm()
    client.drive(SPEED)
    client.keep(SPEED, 0.5)
    fault(client, pause=True)
    client.keep(SPEED, 0.5)
    stands = seconds(client)
    client.keep(SPEED, 1.0)
    assert seconds(client) == stands
    fault(client, pause=False)
    client.wait("the time", lambda: seconds(client) > stands + 1.5, lambda: client.send(SPEED))
    result = {"paused": speed(client), "after_pause": client.status()}
    client.drive(SPEED)
    before = seconds(client)
    fault(client, reset=True)
    client.wait("the reset", lambda: seconds(client) < before, lambda: client.send(SPEED))
    client.wait("the time", lambda: seconds(client) > 1.5, lambda: client.send(SPEED))
    result |= {"reset": speed(client), "after_reset": client.status()}
    print(json.dumps(result))


def fault(client: Client, **values: Any) -> None:
    client.publish("/engine/fault", String(data=json.dumps(values)))


if __name__ == "__main__":
    main()
