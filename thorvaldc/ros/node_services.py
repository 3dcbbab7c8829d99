"""The ROS services of the node: each calls a service of the driver with the same meaning."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any, cast

from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from thorvaldc.ros.parameters import PARAMETER_SET
from thorvaldc.ros.topic_twists import OWNER
from thorvaldc.runtime.can_base.battery_and_io_drivers import IoBoardDriver
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.service_table import ServiceError


def create_services(node: Any) -> list[Any]:
    """Creates the services on a ``BaseDriverNode`` and returns them."""

    def robot() -> DrivenRobot:
        if node.robot is None:
            problem = f" ({node.problem})" if node.problem else ""
            raise ServiceError(f"the node is inactive{problem}; activate it first")
        return cast(DrivenRobot, node.robot)

    def call(service: str, **arguments: Any) -> str:
        result = robot().call(service, OWNER, **arguments)
        if result is None or isinstance(result, str):
            return result or ""
        return json.dumps(result)

    def enable(on: bool) -> str:
        return _arm(robot(), node.clock_watch.problem) if on else call("disarm")

    def safety_stop(on: bool) -> str:
        return call("safety_stop" if on else "release_safety_stop")

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
        "enable": enable,
        "safety_stop": safety_stop,
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
    elif base in ("ideal", "mujoco"):
        switches["pause_simulation"] = pause
        triggers["reset_simulation"] = reset
    if node.model.parameter_sets:
        triggers["use_ordinary_parameters"] = use("")
    for parameter_set in node.model.parameter_sets:
        triggers[_name(f"use_{parameter_set.name}")] = use(parameter_set.name)
    others = [_motor_settings(node, call)] if base in ("bus", "virtual") else []
    return [
        *others,
        *(_switch(node, name, work) for name, work in switches.items()),
        *(_trigger(node, name, work) for name, work in triggers.items()),
    ]


def _motor_settings(node: Any, call: Callable[..., str]) -> Any:
    """Creates the service that writes settings of motor controllers, one after another.

    The name of a parameter is `CONTROLLER.SETTING`, or `SETTING` for all motor controllers.
    """
    service = "setup_motor_controller"

    def write(parameter: Any) -> None:
        controller, _, setting = parameter.name.rpartition(".")
        if parameter.value.type not in (
            ParameterType.PARAMETER_INTEGER,
            ParameterType.PARAMETER_DOUBLE,
        ):
            raise ServiceError(f"{parameter.name} needs a number, in the units of the controller")
        value = float(parameter_value_to_python(parameter.value))
        call(service, node=controller, setting=setting, value=value)

    def serve(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            result = SetParametersResult(successful=True)
            try:
                write(parameter)
            except ServiceError as error:
                result = SetParametersResult(successful=False, reason=str(error))
            response.results.append(result)
        return response

    return node.create_service(SetParameters, service, node.guarded(service, serve))


def _switch(node: Any, name: str, work: Callable[[bool], str]) -> Any:
    def serve(request: Any, response: Any) -> Any:
        return _answer(response, lambda: work(bool(request.data)))

    return node.create_service(SetBool, name, node.guarded(name, serve))


def _trigger(node: Any, name: str, work: Callable[[], str]) -> Any:
    def serve(request: Any, response: Any) -> Any:
        return _answer(response, work)

    return node.create_service(Trigger, name, node.guarded(name, serve))


def _answer(response: Any, work: Callable[[], str]) -> Any:
    try:
        response.message, response.success = work(), True
    except ServiceError as error:
        response.message, response.success = str(error), False
    return response


def _arm(robot: DrivenRobot, clock_problem: str) -> str:
    """Arms the robot, and returns what still keeps it from moving, or an empty text.

    Raises ``ServiceError`` with the reason if it cannot be armed, or if the time stands still.
    """
    if clock_problem:
        raise ServiceError(clock_problem)
    if robot.paused:  # an armed robot does not move either
        raise ServiceError("the simulation is paused")
    was_armed = robot.armed
    waits_for = robot.call("arm", OWNER)
    reasons = [waits_for] if waits_for else []
    reasons += [
        f"the lock `{name}` is active" for name in robot.multiplexer.active_locks(robot.now)
    ]
    if was_armed:  # otherwise the state is that before the arming
        state = robot.driver.state
        reasons += filter(None, (state.fault, state.hold_reason))
    return "; ".join(reasons)


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
