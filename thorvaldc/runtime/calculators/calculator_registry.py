"""Base calculators by name, from here and from other packages, and their options."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

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
        "random_pairs": "thorvaldc.runtime.calculators.random_pairs:RandomPairs",
    },
)

_KINDS = {bool: "true or false,", int: "a whole number", float: "a number", str: "text"}


class CalculatorFault(DiagnosticError):
    """What is wrong with a robot's choice; ``option`` is the option it is about, if any."""

    option: str | None = None


def names() -> list[str]:
    """Return the names of all calculators, built-in and plugged-in, in alphabetical order."""
    return PLUGINS.names()


def calculator_class(name: str) -> type[BaseCalculator]:
    """Return the calculator class of this name.

    Raises ``CalculatorFault`` where there is none or where it cannot be used.
    """
    cls = PLUGINS.load(name)
    if not isinstance(cls, PluginFailure):
        return cls
    if cls.unknown:
        known = names()
        hint = did_you_mean(name, known, f"known: {', '.join(known)}")
        raise CalculatorFault(
            "calculator-unknown", f"there is no base calculator `{name}`", hint=hint
        )
    raise CalculatorFault(
        "calculator-unknown",
        f"base calculator `{name}` {cls.reason}",
        hint="install its package again, or report this to its authors",
    )


def for_robot(robot: Robot) -> BaseCalculator:
    """The calculator that the robot's file names, for its wheels and its noise.

    The wheels have their ordinary radii.  Raises ``CalculatorFault`` for an unknown calculator,
    for one that cannot drive this robot and for an invalid option.
    """
    for fault in faults(robot):
        raise fault
    cls = calculator_class(robot.calculator.name)
    options, _ = _options(cls, robot)
    noise = Noise(**dict(robot.driver.noise))
    return cls(BaseGeometry.from_robot(robot), options, noise)


def faults(robot: Robot) -> list[CalculatorFault]:
    """All that is wrong with the robot's choice of a calculator and its options."""
    try:
        cls = calculator_class(robot.calculator.name)
    except CalculatorFault as error:
        said = error.diagnostic
        return [CalculatorFault(said.code.name, said.message, robot.span, hint=said.hint)]
    found = _options(cls, robot)[1]
    reason = cls.unsuited(BaseGeometry.from_robot(robot))
    if reason is not None:
        text = f"base calculator `{cls.name}` cannot drive {robot.name}: {reason}"
        hint = (
            "use base_calculator: general, which drives any arrangement of wheels"
            if cls.name != "general"
            else "give the robot a wheel with a motor"
        )
        found.insert(0, CalculatorFault("calculator-unsuited", text, robot.span, hint=hint))
    return found


def _options(cls: type[BaseCalculator], robot: Robot) -> tuple[Any, list[CalculatorFault]]:
    """The options as the calculator wants them, and what is wrong with those given."""
    known = {field.name: field.default for field in dataclasses.fields(cls.Options)}
    given: dict[str, Any] = {}
    found: list[CalculatorFault] = []

    def say(key: str | None, text: str, hint: str | None = None) -> None:
        fault = CalculatorFault("calculator-option", text, robot.span, hint=hint)
        fault.option = key
        found.append(fault)

    for key, value in robot.calculator.options:
        if key not in known:
            its = f"its options: {', '.join(known)}" if known else "it has no options"
            text = f"base calculator `{cls.name}` has no option `{key}`"
            say(key, text, did_you_mean(key, known, its))
            continue
        default = known[key]
        if isinstance(default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(default):
            say(
                key,
                f"option `{key}` of base calculator `{cls.name}` is {json.dumps(value)}; "
                f"expected {_KINDS[type(default)]} such as {json.dumps(default)}",
            )
            continue
        try:
            cls.Options(**{key: value})
        except ValueError as fault:
            say(key, f"base calculator `{cls.name}`: {fault}")
            continue
        given[key] = value
    try:
        return cls.Options(**given), found
    except ValueError as fault:  # values that do not go together
        say(None, f"base calculator `{cls.name}`: {fault}")
        return cls.Options(), found
