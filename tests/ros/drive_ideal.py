"""Drives a node with ideal joints: ``python -m tests.ros.drive_ideal PROCESS_OF_THE_NODE``."""

from __future__ import annotations

import math
import sys

from lifecycle_msgs.msg import Transition

from tests.ros.client import Client


def main() -> None:
    process = int(sys.argv[1])
    client = Client()
    lifecycle(client)
    arming(client)
    messages(client)
    time_out(client)
    refused_twists(client)
    parameters(client)
    stops(client)
    frozen_process(client, process)
    deactivation(client)


def lifecycle(client: Client) -> None:
    assert client.lifecycle() == "unconfigured"
    assert client.change(Transition.TRANSITION_CONFIGURE)
    assert client.switch("enable") == (False, "the node is inactive; activate it first")
    client.wait("diagnostics", lambda: client.status() == "inactive")
    assert client.change(Transition.TRANSITION_ACTIVATE)
    assert client.lifecycle() == "active"
    client.wait("odometry", lambda: "base_raw" in client.last)


def arming(client: Client) -> None:
    assert max(client.keep(0.3, 0.6)) == 0.0
    assert client.status() == "waiting: disarmed"
    ok, reason = client.switch("enable", work=lambda: client.send(0.3))
    assert not ok
    assert reason == "`auto_nav` commands a motion"
    client.arm()
    client.drive(0.3)


def messages(client: Client) -> None:
    odometry, joints = client.last["base_raw"], client.last["joint_states"]
    assert odometry.header.frame_id == "odom"
    assert odometry.child_frame_id == "base_link"
    # Two wheels that are 1 % off; a node with `for_filters` says ten times as much later.
    speed = odometry.twist.twist.linear.x
    assert 0.0 < math.sqrt(odometry.twist.covariance[0]) < 0.03 * speed
    assert odometry.twist.covariance[35] > 0.0
    assert odometry.pose.covariance[0] > 0.0
    assert "left_wheel_spin" in joints.name or len(joints.name) >= 4, joints.name
    assert len(joints.name) == len(joints.position) == len(joints.velocity)
    state = client.last["base_state"]
    assert (state.level, state.message) == (b"\x00", "driving")
    assert {value.key: value.value for value in state.values}["armed"] == "true"
    commands = client.last["joint_commands"]
    assert commands.name[:2] == ["left_drive_axle", "right_drive_axle"], commands.name
    assert min(commands.velocity[:2]) > 1.0
    assert all(map(math.isnan, commands.position[:2]))
    client.wait(
        "the speeds of the joints",
        lambda: max(client.last["joint_states"].velocity) > 1.0,
        lambda: client.send(0.3),
    )
    client.wait(
        "the source", lambda: client.values("driver").get("source"), lambda: client.send(0.3)
    )


def time_out(client: Client) -> None:
    client.rest()
    client.wait("time-out", lambda: client.status().startswith("timed out"))
    client.keep(0.0, 0.1)
    client.drive(0.3)
    # Another source with a higher priority wins, and its time-out gives way.
    client.drive(-0.2, source="teleop_joy")
    client.drive(0.3)


def refused_twists(client: Client) -> None:
    client.rest()
    assert max(client.keep(math.nan, 0.4)) < 1e-3
    client.wait(
        "refusals",
        lambda: client.values("commands").get("auto_nav.reason") == "the twist is not finite",
        lambda: client.send(math.inf),
    )


def parameters(client: Client) -> None:
    described = client.describe("max_linear_velocity")
    assert described.description.endswith("[m/s]")
    assert not described.read_only
    assert described.floating_point_range[0].from_value > 0.0
    assert client.describe("rate").read_only
    assert client.set(rate=10.0)
    assert client.set(max_linear_velocity=-1.0)
    assert client.set(max_linear_velocity="fast")
    assert client.set(command_timeout=5.0)
    limits(client)
    assert "has no parameter set `rails`; did you mean `rail`?" in client.set(parameter_set="rails")
    assert client.set(max_linear_velocity=0.25) == ""
    client.start()
    assert max(client.keep(1.0, 1.5)) < 0.2501
    client.wait("0.25 m/s", lambda: client.speed() > 0.249, lambda: client.send(1.0))
    assert client.trigger("use_rail") == (True, "")
    client.wait("0.4 m/s", lambda: client.speed() > 0.399, lambda: client.send(1.0))
    client.wait("the set", lambda: client.values("driver").get("parameter_set") == "rail")
    assert client.trigger("use_ordinary_parameters") == (True, "")
    radii_and_noise(client)
    client.rest()


def radii_and_noise(client: Client) -> None:
    """Radii change at rest alone, and follow the parameter set; noise changes while it drives."""
    client.drive(0.3)
    work = {"radius.left_wheel": 0.12}
    assert "its wheel radii can change only at rest" in client.set(**work)
    assert client.set(**{"noise.speed_ratio": 0.02}) == ""
    assert client.set(**{"noise.speed_ratio": -1.0})
    client.rest()
    client.wait("a change at rest", lambda: client.set(**work) == "")
    described = client.describe("radius.left_wheel")
    assert described.description.endswith("it can be changed at rest [m]")
    assert described.floating_point_range[0].to_value == 0.125 * 1.5
    assert client.set(**{"radius.left_wheel": 0.5})
    assert client.trigger("use_rail") == (True, "")
    assert client.get("radius.left_wheel") == 0.09
    assert client.trigger("use_ordinary_parameters") == (True, "")
    assert client.get("radius.left_wheel") == 0.125


def limits(client: Client) -> None:
    """The values of the robot file are the largest ones: each can be set, but none above it.

    A hundredth of it is the smallest one.
    """
    for name in (
        "max_linear_velocity",
        "max_angular_velocity",
        "max_linear_acceleration",
        "max_angular_acceleration",
    ):
        largest = client.describe(name).floating_point_range[0].to_value
        assert client.set(**{name: largest}) == ""
        for value in (0.009 * largest, 1.01 * largest, 99.0, 1e6, math.inf, math.nan):
            assert name in client.set(**{name: value}), value
    largest = client.describe("max_linear_velocity").floating_point_range[0].to_value
    client.start()
    client.wait("full speed", lambda: client.speed() > 0.99 * largest, lambda: client.send(5.0))
    assert max(client.keep(5.0, 1.0)) < largest + 1e-6
    client.rest()


def stops(client: Client) -> None:
    client.drive(0.3)
    assert client.switch("safety_stop") == (True, "")
    client.wait("stop", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    assert not client.switch("enable")[0]
    assert client.switch("safety_stop", False) == (True, "")
    assert max(client.keep(0.3, 0.5)) < 1e-3  # disarmed
    client.arm()
    client.drive(0.3)
    client.lock("safety_stop/lock", True)
    client.wait("lock", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    assert "safety_stop" in client.switch("enable")[1]
    client.lock("safety_stop/lock", False)
    assert max(map(abs, client.keep(0.3, 0.5))) < 1e-3  # disarmed by the lock
    client.wait("disarmed", lambda: "stop lock `safety_stop`" in client.status())
    client.arm()
    client.drive(0.3)
    client.rest()
    client.lock("auto_nav/pause", True)  # a lock that leaves the joystick
    active = "the lock `auto_nav_pause` is active"
    client.wait("pause", lambda: client.switch("enable") == (True, active))
    client.lock("auto_nav/pause", False)
    client.wait("no pause", lambda: client.switch("enable")[1] == "", lambda: client.send(0.0))
    assert client.trigger("reset_base_odom") == (True, "")
    client.spin(0.1)
    assert abs(client.last["base_raw"].pose.pose.position.x) < 1e-3


def frozen_process(client: Client, process: int) -> None:
    client.drive(0.3)
    client.freeze(process, 1.0, 0.3)
    client.spin(0.1)
    client.wait("rest after the gap", lambda: abs(client.speed()) < 1e-3, lambda: client.send(0.3))
    assert max(client.keep(0.3, 0.5)) < 1e-3
    assert "command zero first" in client.status(), client.status()
    client.drive(0.3)


def deactivation(client: Client) -> None:
    client.drive(0.3)
    assert client.change(Transition.TRANSITION_DEACTIVATE)
    client.spin(0.3)
    assert abs(client.speed()) < 0.02
    client.wait("inactive", lambda: client.status() == "inactive")
    assert client.change(Transition.TRANSITION_ACTIVATE)
    assert max(client.keep(0.3, 0.4)) < 0.02  # disarmed again
    client.wait("disarmed", lambda: client.status() == "waiting: disarmed")
    client.send(0.0)
    client.arm()
    client.drive(0.3)


if __name__ == "__main__":
    main()
