"""A ROS program that drives a node in another process, for the programs of the tests."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

TIMEOUT = 120.0
VOID = "send them again"
"""Part of the answer to a request that waited during a gap in time."""
GAP = "no control cycle for"
"""Part of the reasons of a robot that stopped because the computer was busy."""


class Client:
    """A node that sends twists, calls services and keeps the newest messages."""

    def __init__(self, space: str = "", stamped: bool = False) -> None:
        rclpy.init()
        self.node = rclpy.create_node("client")
        self.space, self.stamped = space, stamped
        self.last: dict[str, Any] = {}
        self.counts: dict[str, int] = {}
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self.listen(Odometry, f"{space}/odometry/base_raw")
        self.listen(JointState, f"{space}/joint_states")
        self.listen(JointState, f"{space}/joint_commands")
        self.listen(DiagnosticStatus, f"{space}/base_state")
        self.listen(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))

    def listen(self, kind: Any, topic: str, qos: Any = qos_profile_sensor_data) -> None:
        name = topic.rsplit("/", 1)[-1]

        def keep(message: Any) -> None:
            self.last[name] = message
            self.counts[name] = self.counts.get(name, 0) + 1

        self.node.create_subscription(kind, topic, keep, qos)

    def spin(self, seconds: float = 0.02) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def wait(
        self, what: str, condition: Callable[[], Any], work: Callable[[], None] = lambda: None
    ) -> Any:
        """Waits until ``condition`` is true and returns its value."""
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            work()
            self.spin()
            if value := condition():
                return value
        raise AssertionError(f"not within {TIMEOUT} s: {what}; {self.status()}")

    # -- calls ---------------------------------------------------------------------------------

    def request(
        self, kind: Any, name: str, request: Any, work: Callable[[], None] = lambda: None
    ) -> Any:
        """Calls a service, and repeats ``work`` until the answer comes."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"{self.space}/{name}")
        client = self._clients[name]
        assert client.wait_for_service(TIMEOUT), name
        future = client.call_async(request)
        end = time.monotonic() + TIMEOUT
        while not future.done():
            assert time.monotonic() < end, f"{name} does not answer"
            work()
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=0.05)
        return future.result()

    def switch(
        self, name: str, on: bool = True, work: Callable[[], None] = lambda: None
    ) -> tuple[bool, str]:
        return self._ask(SetBool, name, SetBool.Request(data=on), work)

    def trigger(self, name: str) -> tuple[bool, str]:
        return self._ask(Trigger, name, Trigger.Request())

    def _ask(
        self, kind: Any, name: str, request: Any, work: Callable[[], None] = lambda: None
    ) -> tuple[bool, str]:
        """Calls a service again if the request waited during a gap in time, as on a busy
        computer."""
        end = time.monotonic() + TIMEOUT
        while True:
            answer = self.request(kind, name, request, work)
            if answer.success or VOID not in answer.message or time.monotonic() > end:
                return answer.success, answer.message
            self.spin(0.1)

    def change(self, transition: int) -> bool:
        request = ChangeState.Request()
        request.transition.id = transition
        return bool(self.request(ChangeState, "base_driver/change_state", request).success)

    def lifecycle(self) -> str:
        answer = self.request(GetState, "base_driver/get_state", GetState.Request())
        return str(answer.current_state.label)

    def set(self, **values: Any) -> str:
        """Sets parameters and returns the reason of a refusal, or an empty text."""
        parameters = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        name = "base_driver/set_parameters_atomically"
        result = self.request(SetParametersAtomically, name, request).result
        assert result.successful is not bool(result.reason)
        return str(result.reason)

    def get(self, name: str) -> Any:
        """Returns the value of a parameter."""
        answer = self.request(
            GetParameters, "base_driver/get_parameters", GetParameters.Request(names=[name])
        )
        return parameter_value_to_python(answer.values[0])

    def describe(self, name: str) -> Any:
        request = DescribeParameters.Request(names=[name])
        service = "base_driver/describe_parameters"
        return self.request(DescribeParameters, service, request).descriptors[0]

    # -- driving -------------------------------------------------------------------------------

    def send(
        self,
        vx: float = 0.0,
        wz: float = 0.0,
        source: str = "auto_nav",
        age: float = 0.0,
        frame: str = "",
        no_stamp: bool = False,
    ) -> None:
        topic = f"{self.space}/{source}/cmd_vel"
        if topic not in self._publishers:
            kind = TwistStamped if self.stamped else Twist
            self._publishers[topic] = self.node.create_publisher(kind, topic, 10)
        message: Any = TwistStamped() if self.stamped else Twist()
        twist = message.twist if self.stamped else message
        twist.linear.x, twist.angular.z = vx, wz
        if self.stamped:
            message.header.frame_id = frame
        if self.stamped and not no_stamp:
            stamp = self.node.get_clock().now().nanoseconds - int(age * 1e9)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        self._publishers[topic].publish(message)

    def publish(self, topic: str, message: Any) -> None:
        path = topic if topic.startswith("/") else f"{self.space}/{topic}"
        if path not in self._publishers:
            self._publishers[path] = self.node.create_publisher(type(message), path, 10)
        self._publishers[path].publish(message)

    def lock(self, topic: str, locked: bool) -> None:
        self.publish(topic, Bool(data=locked))

    def arm(self) -> None:
        """Arms the robot, and waits for the homing of its steering.

        On a busy computer a gap in time may refuse it for a moment, or be a fault.
        """
        end = time.monotonic() + TIMEOUT
        while not (answer := self.switch("enable"))[0] or answer[1].startswith("homing"):
            assert time.monotonic() < end, answer
            if GAP in answer[1]:
                self.trigger("reset_faults")
            self.send(0.0)
            self.spin(0.05)

    def start(self, source: str = "auto_nav") -> None:
        """Commands zero for a moment, which a source must do before it moves the robot."""
        self.keep(0.0, 0.1, source=source)

    def drive(self, vx: float, **options: Any) -> None:
        """Drives until the odometry shows the speed, with zero first, as for a new source.

        A gap in time, or another source that falls silent, needs a zero in between; a long gap a
        reset too.
        """
        tries = iter(range(100_000))

        def send() -> None:
            first = next(tries) % 60 == 0
            if first and GAP in self.status():
                self.arm()
            self.send(0.0 if first else vx, **options)

        self.wait(f"{vx} m/s", lambda: abs(self.speed() - vx) < 0.01, send)

    def keep(self, vx: float, seconds: float, **options: Any) -> list[float]:
        """Commands a twist for a time, and returns the speeds of the odometry."""
        speeds, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            self.send(vx, **options)
            self.spin()
            speeds.append(self.speed())
        return speeds

    def rest(self) -> None:
        self.wait("rest", lambda: abs(self.speed()) < 1e-3)

    def speed(self) -> float:
        message = self.last.get("base_raw")
        return float(message.twist.twist.linear.x) if message is not None else 0.0

    def statuses(self) -> dict[str, Any]:
        message = self.last.get("diagnostics")
        statuses = message.status if message is not None else []
        return {status.name.rsplit(": ", 1)[-1]: status for status in statuses}

    def values(self, status: str) -> dict[str, str]:
        found = self.statuses().get(status)
        return {value.key: value.value for value in found.values} if found is not None else {}

    def status(self) -> str:
        """Text of the status of the driver."""
        found = self.statuses().get("driver")
        return str(found.message) if found is not None else ""

    def freeze(self, process: int, seconds: float, vx: float) -> None:
        """Stops a process for a time, while twists for it keep coming."""
        os.kill(process, signal.SIGSTOP)
        try:
            self.keep(0.0, 0.1)
            self.keep(vx, seconds)
        finally:
            os.kill(process, signal.SIGCONT)
