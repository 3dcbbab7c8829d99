"""Declares the parameters of the node, and changes them with the validation of the driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.model_json import load_model
from thorvaldc.ros.bases import NodeError
from thorvaldc.ros.parameters import MODEL_FILE, PARAMETER_SET, PARAMETERS, NodeParameter
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.run_time_parameters import COMMAND_TIMEOUT, LIMITS, Parameters

_LIMITS = (*LIMITS, COMMAND_TIMEOUT)


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


class NodeParameters:
    """The parameters of a node.

    - ``values``: values by name.
    - ``driver``: the limits and radii in force.
    - ``give``: function that gives a parameter set and limits to the base driver of an active node.
      The set is ``None`` if it stays, and an empty text for the ordinary values.  ``give`` raises
      ``ParameterError`` or ``DiagnosticError`` if the driver does not accept them now.
    """

    def __init__(self, node: Any) -> None:
        """Declares the parameters on ``node``, which loads the model.

        Raises ``NodeError`` or ``DiagnosticError`` if a value is wrong.
        """
        self._node = node
        self.give: Callable[[str | None, Mapping[str, Any]], None] = lambda name, limits: None
        table = {parameter.name: parameter for parameter in PARAMETERS}
        model_file = table.pop(MODEL_FILE)
        value = node.declare_parameter(MODEL_FILE, "", _descriptor(model_file, None)).value
        self.values: dict[str, Any] = {MODEL_FILE: value}
        self.robot = robot = load_robot_model(value)
        for name, parameter in table.items():
            descriptor = _descriptor(parameter, robot)
            default = parameter.default_for(robot)
            self.values[name] = node.declare_parameter(name, default, descriptor).value
            if parameter.choices and self.values[name] not in parameter.choices:
                choices = ", ".join(parameter.choices)
                raise NodeError(f"{name} is {self.values[name]!r}; expected {choices}")
        if self.values["rate"] != robot.driver.rate:
            raise NodeError(
                f"rate is {self.values['rate']:g} Hz; the model has {robot.driver.rate:g} Hz:"
                " change `driver.rate` in the robot file and build again"
            )
        overridden = set(getattr(node, "_parameter_overrides", ()))
        limits = {name: self.values[name] for name in _LIMITS if name in overridden}
        try:
            start = Parameters.from_robot(robot, self.values[PARAMETER_SET] or None)
            self.driver = start.changed(robot, limits=limits)
        except ParameterError as error:
            raise NodeError(str(error)) from None
        self._show()
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _changes(self, parameters: Iterable[Any]) -> tuple[str | None, dict[str, Any]]:
        """Returns the new parameter set, or ``None`` if it stays, and the new limits."""
        new_values = {p.name: p.value for p in parameters}
        present = self.values[PARAMETER_SET]
        parameter_set = new_values.get(PARAMETER_SET, present)
        limits = {name: new_values[name] for name in _LIMITS if name in new_values}
        return None if parameter_set == present else parameter_set, limits

    def _proposed(self, parameter_set: str | None, limits: Mapping[str, Any]) -> Parameters:
        """Returns the parameters of the driver after a change.

        Raises ``ParameterError`` or ``DiagnosticError`` if a value is wrong.
        """
        driver = self.driver
        if parameter_set is not None:
            driver = Parameters.from_robot(self.robot, parameter_set or None)
        return driver.changed(self.robot, limits=limits)

    def _check(self, parameters: list[Any]) -> Any:
        unset = [p.name for p in parameters if p.value is None and p.name in self.values]
        if unset:
            reason = f"{unset[0]} needs a value; it cannot be removed"
            return SetParametersResult(successful=False, reason=reason)
        changes = self._changes(parameters)
        try:
            self._proposed(*changes)
            self.give(*changes)
        except DiagnosticError as error:
            return SetParametersResult(successful=False, reason=error.one_line)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        self.driver = self._proposed(*self._changes(parameters))
        self.values.update({p.name: p.value for p in parameters if p.name in self.values})
        self._show()

    def give_all(self) -> None:
        """Gives the present values to the base driver of a node that becomes active."""
        self.give(self.values[PARAMETER_SET], _limits(self.driver))

    def _show(self) -> None:
        """Sets the limits of the node to those of the driver, after a change of the set."""
        shown = _limits(self.driver)
        different = [
            Parameter(name, value=value)
            for name, value in shown.items()
            if value != self.values[name]
        ]
        if different:
            self._node.set_parameters(different)
            self.values.update(shown)


def _limits(parameters: Parameters) -> dict[str, Any]:
    return {name: getattr(parameters.settings, name) for name in _LIMITS}


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
