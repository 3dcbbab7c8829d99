"""Declares the parameters of the node, and changes them with the validation of the driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.model_json import load_model
from thorvaldc.ros import parameters as table
from thorvaldc.ros.bases import NodeError
from thorvaldc.ros.parameters import (
    MODEL_FILE,
    PARAMETER_SET,
    USE_NODE_NAMESPACE,
    NodeParameter,
)
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.run_time_parameters import COMMAND_TIMEOUT, LIMITS, Parameters

_LIMITS = (*LIMITS, COMMAND_TIMEOUT)
Changes = dict[str, dict[str, Any]]
"""New values of the driver by name: `radii`, `noise` and `limits`, as `Parameters.changed` takes
them."""


def load_robot_model(path: str) -> Robot:
    """Returns the robot of a model.json.  Raises ``NodeError`` or ``DiagnosticError``."""
    if not path:
        raise NodeError(
            "the parameter model_file is missing: --ros-args -p model_file:=PATH/model.json"
        )
    file = Path(path)
    if file.is_dir():  # the other files of a build are searched beside the model
        raise NodeError(f"model_file is {path}, a folder; expected the model.json of a build")
    model = load_model(file)
    if not isinstance(model, Robot):
        raise NodeError(f"{path} is a fleet; start a node for the model.json of each robot")
    return model


def declared_model(node: Any) -> Robot:
    """Declares the parameters that name the model on a node, and returns the robot.

    Raises ``NodeError`` or ``DiagnosticError``.
    """
    robot = load_robot_model(declared(node, MODEL_FILE))
    if declared(node, USE_NODE_NAMESPACE):
        robot = replace(robot, namespace=node.get_namespace().strip("/"))
    return robot


def declared(node: Any, name: str) -> Any:
    """Declares one parameter of the tables on a node, and returns its value.

    Raises ``NodeError`` if the value is not one of the choices.
    """
    parameter = next(parameter for parameter in table.PARAMETERS if parameter.name == name)
    value = node.declare_parameter(name, parameter.default, _descriptor(parameter, None)).value
    return _chosen(parameter, value)


def _chosen(parameter: NodeParameter, value: Any) -> Any:
    if parameter.choices and value not in parameter.choices:
        choices = ", ".join(parameter.choices)
        raise NodeError(f"{parameter.name} is {value!r}; expected {choices}")
    return value


class NodeParameters:
    """The parameters of a node.

    - ``values``: values by name.
    - ``driver``: the limits, radii and noise in force.
    - ``give``: function that gives a parameter set and changes to the base driver of an active
      node.  The set is ``None`` if it stays, and an empty text for the ordinary values.  ``give``
      raises ``ParameterError`` or ``DiagnosticError`` if the driver does not accept them now.
    """

    def __init__(self, node: Any) -> None:
        """Declares the parameters on ``node``, which loads the model.

        Raises ``NodeError`` or ``DiagnosticError`` if a value is wrong.
        """
        self._node = node
        self.give: Callable[[str | None, Changes], None] = lambda name, changes: None
        self.robot = robot = declared_model(node)
        self.values: dict[str, Any] = {}
        for parameter in table.parameters_of(robot):
            name = parameter.name
            if node.has_parameter(name):
                self.values[name] = node.get_parameter(name).value
                continue
            descriptor = _descriptor(parameter, robot)
            default = parameter.default_for(robot)
            value = node.declare_parameter(name, default, descriptor).value
            self.values[name] = _chosen(parameter, value)
        if self.values["rate"] != robot.driver.rate:
            raise NodeError(
                f"rate is {self.values['rate']:g} Hz; the model has {robot.driver.rate:g} Hz:"
                " change `driver.rate` in the robot file and build again"
            )
        overridden = set(getattr(node, "_parameter_overrides", ()))
        changes = _changes({n: self.values[n] for n in self.values if n in overridden})
        try:
            start = Parameters.from_robot(robot, self.values[PARAMETER_SET] or None)
            self.driver = start.changed(robot, **changes)
        except ParameterError as error:
            raise NodeError(str(error)) from None
        self._show()
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _changed(self, parameters: Iterable[Any]) -> tuple[str | None, Changes]:
        """Returns the new parameter set, or ``None`` if it stays, and the changes."""
        new_values = {p.name: p.value for p in parameters}
        present = self.values[PARAMETER_SET]
        parameter_set = new_values.get(PARAMETER_SET, present)
        return None if parameter_set == present else parameter_set, _changes(new_values)

    def _proposed(self, parameter_set: str | None, changes: Changes) -> Parameters:
        """Returns the parameters of the driver after a change.

        Raises ``ParameterError`` or ``DiagnosticError`` if a value is wrong.
        """
        driver = self.driver
        if parameter_set is not None:
            driver = Parameters.from_robot(self.robot, parameter_set or None)
        return driver.changed(self.robot, **changes)

    def _check(self, parameters: list[Any]) -> Any:
        unset = [p.name for p in parameters if p.value is None and p.name in self.values]
        if unset:
            reason = f"{unset[0]} needs a value; it cannot be removed"
            return SetParametersResult(successful=False, reason=reason)
        changed = self._changed(parameters)
        try:
            self._proposed(*changed)
            self.give(*changed)
        except DiagnosticError as error:
            return SetParametersResult(successful=False, reason=error.one_line)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        self.driver = self._proposed(*self._changed(parameters))
        self.values.update({p.name: p.value for p in parameters if p.name in self.values})
        self._show()

    def give_all(self) -> None:
        """Gives the present values to the base driver of a node that becomes active."""
        self.give(self.values[PARAMETER_SET], _changes(self._in_force()))

    def _in_force(self) -> dict[str, Any]:
        """Returns the values of the driver by the names of the parameters."""
        driver = self.driver
        radii = zip(self.robot.wheels, driver.radii, strict=True)
        return {
            **{name: getattr(driver.settings, name) for name in _LIMITS},
            **{f"{table.RADIUS}{wheel.name}": radius for wheel, radius in radii},
            **{f"{table.NOISE}{n}": v for n, v in asdict(driver.noise).items() if v is not None},
        }

    def _show(self) -> None:
        """Sets the parameters of the node to those of the driver, after a change of the set."""
        shown = self._in_force()
        different = [
            Parameter(name, value=value)
            for name, value in shown.items()
            if value != self.values.get(name, value)
        ]
        if different:
            self._node.set_parameters(different)
            self.values.update({name: shown[name] for name in shown if name in self.values})


def _changes(values: Mapping[str, Any]) -> Changes:
    """Returns the changes of the driver that new values of parameters mean."""

    def beginning_with(start: str) -> dict[str, Any]:
        return {n.removeprefix(start): v for n, v in values.items() if n.startswith(start)}

    limits = {name: values[name] for name in _LIMITS if name in values}
    return {
        "radii": beginning_with(table.RADIUS),
        "noise": beginning_with(table.NOISE),
        "limits": limits,
    }


def _descriptor(parameter: NodeParameter, robot: Robot | None) -> Any:
    descriptor = ParameterDescriptor(
        name=parameter.name, description=parameter.text, read_only=parameter.read_only
    )
    if robot is None:
        return descriptor
    lowest, highest = parameter.range_for(robot)
    if math.isfinite(lowest) and math.isfinite(highest):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=lowest, to_value=highest, step=0.0)
        ]
    return descriptor
