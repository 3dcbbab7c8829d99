"""Declares the parameters of the node, and changes them with the validation of the driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.model_json import load_model
from thorvaldc.ros.bases import NodeError
from thorvaldc.ros.parameters import BASES, MODEL_FILE, PARAMETER_SET, PARAMETERS, NodeParameter
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.run_time_parameters import COMMAND_TIMEOUT, LIMITS, Parameters

_LIMITS = (*LIMITS, COMMAND_TIMEOUT)


def load_robot_model(path: str) -> Robot:
    """Returns the robot of a model.json.  Raises ``NodeError`` or ``DiagnosticError``."""
    if not path:
        raise NodeError(
            "the parameter model_file is missing: --ros-args -p model_file:=PATH/model.json"
        )
    file = Path(path)
    if file.name != "model.json":
        raise NodeError(f"model_file is {path}; expected the file model.json of a build")
    model = load_model(file.parent)
    if not isinstance(model, Robot):
        raise NodeError(f"{path} is a fleet; start a node for the model.json of each robot")
    return model


class NodeParameters:
    """The parameters of a node.

    ``values``: values by name.  ``driver``: the limits and radii in force.  ``changed``: function
    that is called after a change of ``driver``.
    """

    def __init__(self, node: Any) -> None:
        """Declares the parameters on ``node``, which loads the model.

        Raises ``NodeError`` or ``DiagnosticError`` if a value is wrong.
        """
        self._node = node
        self.changed: Callable[[], None] = lambda: None
        table = {parameter.name: parameter for parameter in PARAMETERS}
        model_file = table.pop(MODEL_FILE)
        value = node.declare_parameter(MODEL_FILE, "", _descriptor(model_file, None)).value
        self.values: dict[str, Any] = {MODEL_FILE: value}
        self.robot = robot = load_robot_model(value)
        for name, parameter in table.items():
            descriptor = _descriptor(parameter, robot)
            default = parameter.default_for(robot)
            self.values[name] = node.declare_parameter(name, default, descriptor).value
        if self.values["base"] not in BASES:
            raise NodeError(f"base is {self.values['base']!r}; expected {', '.join(BASES)}")
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

    def _proposed(self, parameters: Iterable[Any]) -> Parameters:
        """Returns the parameters of the driver after a change.

        Raises ``ParameterError`` or ``DiagnosticError`` if a value is wrong.
        """
        new_values = {p.name: p.value for p in parameters}
        driver = self.driver
        if PARAMETER_SET in new_values and new_values[PARAMETER_SET] != self.values[PARAMETER_SET]:
            driver = Parameters.from_robot(self.robot, new_values[PARAMETER_SET] or None)
        limits = {name: new_values[name] for name in _LIMITS if name in new_values}
        return driver.changed(self.robot, limits=limits)

    def _check(self, parameters: list[Any]) -> Any:
        unset = [p.name for p in parameters if p.value is None and p.name in self.values]
        if unset:
            reason = f"{unset[0]} needs a value; it cannot be removed"
            return SetParametersResult(successful=False, reason=reason)
        try:
            self._proposed(parameters)
        except DiagnosticError as error:
            diagnostic = error.diagnostic
            reason = "; ".join(filter(None, (diagnostic.message, diagnostic.hint)))
            return SetParametersResult(successful=False, reason=reason)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        proposed = self._proposed(parameters)
        self.values.update({p.name: p.value for p in parameters if p.name in self.values})
        if any(p.name in (PARAMETER_SET, *_LIMITS) for p in parameters):
            self.driver = proposed
            self.changed()
            self._show()

    def apply_to(self, driver: BaseDriver) -> None:
        """Gives the parameters to a base driver, which follows them from the next cycle on."""
        driver.use(self.values[PARAMETER_SET] or None)
        driver.update(**{name: getattr(self.driver.settings, name) for name in _LIMITS})

    def _show(self) -> None:
        """Sets the limits of the node to those of the driver, after a change of the set."""
        settings = self.driver.settings
        shown = {name: getattr(settings, name) for name in _LIMITS}
        different = [
            Parameter(name, value=value)
            for name, value in shown.items()
            if value != self.values[name]
        ]
        if different:
            self._node.set_parameters(different)
            self.values.update(shown)


def _descriptor(parameter: NodeParameter, robot: Robot | None) -> Any:
    descriptor = ParameterDescriptor(
        name=parameter.name, description=parameter.text, read_only=parameter.read_only
    )
    lowest, highest = (parameter.lowest, math.inf) if robot is None else parameter.range_for(robot)
    if math.isfinite(lowest) and math.isfinite(highest):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=lowest, to_value=highest, step=0.0)
        ]
    return descriptor
