"""Drives a node ``/r1`` with MuJoCo, its clock and stamped twists."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from lifecycle_msgs.msg import Transition
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from tests.ros.client import Client


def main() -> None:
    client = Client("/r1", stamped=True)
    client.node.set_parameters([Parameter("use_sim_time", value=True)])
    client.listen(Clock, "/clock")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    client.listen(String, "/r1/robot_description", latched)
    client.listen(String, "/r1/robot_model", latched)
    client.wait("clock", lambda: client.node.get_clock().now().nanoseconds > 0)
    client.wait(
        "description", lambda: "<robot" in getattr(client.last.get("robot_description"), "data", "")
    )
    client.wait("model", lambda: "robot_model" in client.last)
    model = json.loads(client.last["robot_model"].data)
    content = Path(model["model_file"]).read_bytes()
    assert model["sha256"] == hashlib.sha256(content).hexdigest()
    assert json.loads(content)["model"]["name"] == model["robot"]
    assert client.lifecycle() == "active"  # by autostart, and not armed
    assert max(client.keep(0.3, 0.4)) < 0.01
    client.arm()
    client.drive(0.3)
    client.rest()
    ages(client)
    pause(client)
    reset(client)
    assert client.change(Transition.TRANSITION_DEACTIVATE)
    assert client.change(Transition.TRANSITION_CLEANUP)
    assert client.lifecycle() == "unconfigured"


def ages(client: Client) -> None:
    # Not a multiple of the period: a stamp of exactly zero would mean now.
    for age, reason in ((2.01, "max_command_age is 0.5 s"), (-1.01, "max_command_lead is 0.1 s")):
        assert max(client.keep(0.3, 0.4, age=age)) < 0.02
        client.wait(
            reason,
            lambda reason=reason: reason in client.values("commands").get("auto_nav.reason", ""),
            lambda age=age: client.send(0.3, age=age),
        )


def pause(client: Client) -> None:
    client.drive(0.3)
    assert client.switch("pause_simulation") == (True, "")
    client.spin(0.2)
    assert client.switch("enable") == (False, "the simulation is paused")
    clock = client.last["clock"].clock
    client.keep(0.3, 0.3)
    assert client.last["clock"].clock == clock
    assert client.switch("pause_simulation", False) == (True, "")
    client.spin(0.1)
    client.wait("rest", lambda: abs(client.speed()) < 0.02, lambda: client.send(0.3))
    client.drive(0.3)


def reset(client: Client) -> None:
    before = client.last["clock"].clock.sec
    assert before >= 1
    assert client.trigger("reset_simulation") == (True, "")
    client.wait("the clock at 0", lambda: client.last["clock"].clock.sec < before)
    assert max(client.keep(0.3, 0.5)[5:]) < 0.02
    client.wait("disarmed", lambda: client.status() == "waiting: disarmed")
    assert abs(client.last["base_raw"].pose.pose.position.x) < 0.05


if __name__ == "__main__":
    main()
