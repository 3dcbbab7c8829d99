"""Loads base calculators by name and validates their options."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from thorvaldc.diagnostics import Proposal
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.runtime.calculators.base_calculator import BaseCalculator
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.twist_fit import Noise

PLUGINS: PluginTable[BaseCalculator] = PluginTable(
    "thorvaldc.base_calculators",
    BaseCalculator,
    {
        "general": "thorvaldc.runtime.calculators.general:General",
        "differential": "thorvaldc.runtime.calculators.differential:Differential",
        "one_wheel": "thorvaldc.runtime.calculators.one_wheel:OneWheel",
    },
)

_TYPE_NAMES = {bool: "true or false,", int: "a whole number", float: "a number", str: "text"}


class CalculatorError(DiagnosticError):
    """The robot file names an invalid calculator or an invalid option.

    The attribute ``option`` is the name of the invalid option, or ``None`` if the calculator itself
    is invalid.
    """

    option: str | None = None


def calculator_names() -> list[str]:
    """Returns the names of all built-in and installed calculators in alphabetical order."""
    return PLUGINS.names()


def calculator_class(name: str) -> type[BaseCalculator]:
    """Returns the class of the base calculator with the name ``name``.

    Raises ``CalculatorError`` if no calculator has this name or its class cannot be loaded.
    """
    cls = PLUGINS.load(name)
    if not isinstance(cls, PluginFailure):
        return cls
    if cls.unknown:
        known = calculator_names()
        hint = did_you_mean(name, known, f"known: {', '.join(known)}")
        raise CalculatorError(
            "calculator-unknown", f"there is no base calculator `{name}`", hint=hint
        )
    raise CalculatorError(
        "calculator-unknown",
        f"base calculator `{name}` {cls.reason}",
        hint="install its package again, or report this to its authors",
    )


def for_robot(robot: Robot) -> BaseCalculator:
    """Returns the calculator that the robot file names, with its options and noise.

    The calculator uses the ordinary wheel radii of the robot file, not a parameter set.  Raises
    ``CalculatorError`` if the calculator is unknown, if it cannot drive this robot, or if an option
    is invalid.
    """
    for error in calculator_errors(robot):
        raise error
    cls = calculator_class(robot.calculator.name)
    options, _ = _read_options(cls, robot)
    noise = Noise(**dict(robot.driver.noise))
    return cls(BaseGeometry.from_robot(robot), options, noise)


def calculator_errors(robot: Robot) -> list[CalculatorError]:
    """Returns all errors in the robot file's calculator and calculator options."""
    try:
        cls = calculator_class(robot.calculator.name)
    except CalculatorError as error:
        diagnostic = error.diagnostic
        return [
            CalculatorError(
                diagnostic.code.name, diagnostic.message, robot.span, hint=diagnostic.hint
            )
        ]
    _, errors = _read_options(cls, robot)
    reason = cls.unsuited_reason(BaseGeometry.from_robot(robot))
    if reason is not None:
        text = f"base calculator `{cls.name}` cannot drive {robot.name}: {reason}"
        hint = (
            Proposal("use `general`, which drives any arrangement of wheels", "general")
            if cls.name != "general"
            else "give the robot a wheel with a motor"
        )
        errors.insert(0, CalculatorError("calculator-unsuited", text, robot.span, hint=hint))
    return errors


def _read_options(cls: type[BaseCalculator], robot: Robot) -> tuple[Any, list[CalculatorError]]:
    """Returns the robot's calculator options, and all errors in these options.

    The options are an instance of ``cls.Options``.  An invalid option of the calculator is replaced
    by its default value.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(cls.Options)}
    valid: dict[str, Any] = {}
    errors: list[CalculatorError] = []

    def report(option: str | None, text: str, hint: str | None = None) -> None:
        error = CalculatorError("calculator-option", text, robot.span, hint=hint)
        error.option = option
        errors.append(error)

    for name, value in robot.calculator.options:
        if name not in defaults:
            names = f"its options: {', '.join(defaults)}" if defaults else "it has no options"
            text = f"base calculator `{cls.name}` has no option `{name}`"
            report(name, text, did_you_mean(name, defaults, names))
            continue
        default = defaults[name]
        if isinstance(default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(default):
            report(
                name,
                f"option `{name}` of base calculator `{cls.name}` is {json.dumps(value)}; "
                f"expected {_TYPE_NAMES[type(default)]} such as {json.dumps(default)}",
            )
            continue
        try:
            cls.Options(**{name: value})
        except ValueError as error:
            report(name, f"base calculator `{cls.name}`: {error}")
            continue
        valid[name] = value
    try:
        return cls.Options(**valid), errors
    except ValueError as error:  # two options with valid values can exclude each other
        report(None, f"base calculator `{cls.name}`: {error}")
        return cls.Options(), errors
