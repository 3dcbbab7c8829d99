"""The ROS services of the node: each calls a service of the driver with the same meaning."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from thorvaldc.ros.parameters import PARAMETER_SET
from thorvaldc.ros.topic_twists import OWNER
from thorvaldc.runtime.can_base.battery_and_io_drivers import IoBoardDriver
from thorvaldc.runtime.service_table import ServiceError


def create_services(node: Any) -> list[Any]:
    """Creates the services on a ``BaseDriverNode`` and returns them."""

    def call(service: str, **arguments: Any) -> str:
        if node.robot is None:
            raise ServiceError("the node is inactive; activate it first")
        result = node.robot.call(service, OWNER, **arguments)
        if result is None or isinstance(result, str):
            return result or ""
        return json.dumps(result)

    def switch(on: str, off: str) -> Callable[[bool], str]:
        return lambda value: call(on if value else off)

    def use(name: str) -> Callable[[], str]:
        def apply() -> str:
            (result,) = node.set_parameters([Parameter(PARAMETER_SET, value=name)])
            if not result.successful:
                raise ServiceError(result.reason)
            return ""

        return apply

    def pause(paused: bool) -> str:
        node.simulation().pause(paused)
        return ""

    def reset() -> str:
        node.simulation()
        node.restart_simulation()
        return ""

    switches: dict[str, Callable[[bool], str]] = {
        "enable": switch("arm", "disarm"),
        "safety_stop": switch("safety_stop", "release_safety_stop"),
    }
    triggers: dict[str, Callable[[], str]] = {
        name: lambda service=service: call(service)  # type: ignore[misc]
        for name, service in (
            ("reset_faults", "reset_faults"),
            ("reset_base_odom", "reset_odometry"),
            ("state", "state"),
        )
    }
    base = node.values["base"]
    if base in ("bus", "virtual"):
        home, zero = "home_steering", "set_home_count_current_position_zero"
        triggers[home] = lambda: call(home)
        triggers["set_home_count_current_pos_zero"] = lambda: call(zero)
        switches["mute_extra_can_device_commands"] = lambda on: call("mute_devices", muted=on)
        for board, output in _outputs(node):
            switches[_name(f"{board}_set_{output}")] = lambda on, board=board, output=output: call(  # type: ignore[misc]
                "set_output", board=board, output=output, on=on
            )
    else:
        switches["pause_simulation"] = pause
        triggers["reset_simulation"] = reset
    if node.model.parameter_sets:
        triggers["use_ordinary_parameters"] = use("")
    for parameter_set in node.model.parameter_sets:
        triggers[_name(f"use_{parameter_set.name}")] = use(parameter_set.name)
    return [
        *(_switch(node, name, work) for name, work in switches.items()),
        *(_trigger(node, name, work) for name, work in triggers.items()),
    ]


def _switch(node: Any, name: str, work: Callable[[bool], str]) -> Any:
    def serve(request: Any, response: Any) -> Any:
        return _answer(response, lambda: work(bool(request.data)))

    return node.create_service(SetBool, name, serve)


def _trigger(node: Any, name: str, work: Callable[[], str]) -> Any:
    def serve(request: Any, response: Any) -> Any:
        return _answer(response, work)

    return node.create_service(Trigger, name, serve)


def _answer(response: Any, work: Callable[[], str]) -> Any:
    try:
        response.message, response.success = work(), True
    except ServiceError as error:
        response.message, response.success = str(error), False
    return response


def _outputs(node: Any) -> list[tuple[str, str]]:
    """Returns the outputs of all IO boards, from the model."""
    return [
        (n.name, output)
        for bus in node.model.buses
        for n in bus.nodes
        if n.protocol == "thorvald_io"
        for output in IoBoardDriver(bus, n).outputs
    ]


def _name(text: str) -> str:
    """Returns an allowed name of a ROS service that is similar to a text."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
