"""Sends requests and messages that no node can follow to a node with ideal joints that drives."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    SetParameters,
    SetParametersAtomically,
)
from rosgraph_msgs.msg import Clock

from tests.ros.client import Client

SPEED = 0.5
UNKNOWN_TYPE = 99


def main() -> None:
    client = Client()
    client.wait("odometry", lambda: "base_raw" in client.last)
    client.arm()
    client.drive(SPEED)
    transitions(client)
    parameters(client)
    keeps_driving(client)
    cut_off_message(client)
    wrong_clock(client)


def keeps_driving(client: Client) -> None:
    assert min(client.keep(SPEED, 0.3)) > SPEED - 0.02


def transitions(client: Client) -> None:
    """Requests transitions that an active node does not have, or that do not exist."""
    for number, label in (
        (Transition.TRANSITION_CONFIGURE, ""),
        (Transition.TRANSITION_ACTIVATE, ""),
        (Transition.TRANSITION_CLEANUP, ""),
        (Transition.TRANSITION_DESTROY, ""),
        (Transition.TRANSITION_ON_ACTIVATE_SUCCESS, ""),
        (0, "activate"),
        (0, "no such transition"),
        (255, ""),
    ):
        request = ChangeState.Request()
        request.transition.id, request.transition.label = number, label
        name = "base_driver/change_state"
        assert not client.request(ChangeState, name, request).success, (number, label)
        keeps_driving(client)
    assert client.lifecycle() == "active"


def parameters(client: Client) -> None:
    values = {
        "max_linear_velocity": ParameterValue(type=UNKNOWN_TYPE),
        "max_angular_velocity": ParameterValue(type=ParameterType.PARAMETER_NOT_SET),
        "command_timeout": ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="1"),
        "use_sim_time": ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=1),
        "parameter_set": ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True),
        "no_such_parameter": ParameterValue(type=ParameterType.PARAMETER_DOUBLE),
    }
    wrong = [Parameter(name=name, value=value) for name, value in values.items()]
    request = SetParameters.Request(parameters=wrong)
    results = client.request(SetParameters, "base_driver/set_parameters", request).results
    assert len(results) == len(wrong)
    assert not any(result.successful for result in results)
    assert all(result.reason for result in results)
    keeps_driving(client)
    name = "base_driver/set_parameters_atomically"
    for parameter in wrong:
        at_once = SetParametersAtomically.Request(parameters=[parameter])
        result = client.request(SetParametersAtomically, name, at_once).result
        assert not result.successful, parameter
        assert result.reason
        client.send(SPEED)
    for kind, service in (
        (GetParameters, "get_parameters"),
        (GetParameterTypes, "get_parameter_types"),
        (DescribeParameters, "describe_parameters"),
    ):
        client.request(kind, f"base_driver/{service}", kind.Request(names=["no_such", ""]))
        client.send(SPEED)


def cut_off_message(client: Client) -> None:
    """Sends the first byte of a twist only."""
    publisher = client.node.create_publisher(Twist, "/auto_nav/cmd_vel", 1)
    client.wait("a subscriber", publisher.get_subscription_count, lambda: client.send(SPEED))
    for _ in range(5):
        publisher.publish(b"\0\1\0\0\1")
        keeps_driving(client)


def wrong_clock(client: Client) -> None:
    """A time before 1970, with which rclpy cannot do anything, stops the robot."""
    assert client.set(use_sim_time=True) == ""
    wrong = Clock(clock=Time(sec=-5))
    client.wait(
        "rest",
        lambda: abs(client.speed()) < 1e-3,
        lambda: (client.publish("/clock", wrong), client.send(SPEED)),
    )
    assert client.set(use_sim_time=False) == ""
    client.drive(SPEED)


if __name__ == "__main__":
    main()
