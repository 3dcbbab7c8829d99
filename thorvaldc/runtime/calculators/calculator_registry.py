"""Base calculators by name, from here and from other packages, and their options."""

from __future__ import annotations

import dataclasses
import json
from importlib import import_module
from typing import Any

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.runtime.calculators.base_calculator import BaseCalculator
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.twist_fit import Noise

BUILTIN: dict[str, str] = {
    "general": "thorvaldc.runtime.calculators.general:General",
    "differential": "thorvaldc.runtime.calculators.differential:Differential",
    "one_wheel": "thorvaldc.runtime.calculators.one_wheel:OneWheel",
    "random_pairs": "thorvaldc.runtime.calculators.random_pairs:RandomPairs",
}
ENTRY_POINT_GROUP = "thorvaldc.base_calculators"


_KINDS = {bool: "true or false,", int: "a whole number", float: "a number", str: "text"}


class CalculatorFault(DiagnosticError):
    """What is wrong with a robot's choice; ``option`` is the option it is about, if any."""

    option: str | None = None


def names() -> list[str]:
    """All calculators, built in and from outside, in alphabetical order."""
    from importlib.metadata import entry_points

    return sorted({*BUILTIN, *(e.name for e in entry_points(group=ENTRY_POINT_GROUP))})


def calculator_class(name: str) -> type[BaseCalculator]:
    """The calculator of that name.

    Raises ``KeyError`` for an unknown one, ``TypeError`` where another package
    offers something else under that name, and what loading it raises.
    """
    if name in BUILTIN:
        module, attribute = BUILTIN[name].split(":")
        builtin: type[BaseCalculator] = getattr(import_module(module), attribute)
        return builtin
    from importlib.metadata import entry_points

    for entry in entry_points(group=ENTRY_POINT_GROUP):
        if entry.name == name:
            found = entry.load()
            if isinstance(found, type) and issubclass(found, BaseCalculator):
                return found
            raise TypeError(f"{entry.value} is no BaseCalculator")
    raise KeyError(name)


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
    choice = robot.calculator
    try:
        cls = calculator_class(choice.name)
    except KeyError:
        known = names()
        hint = did_you_mean(choice.name, known, f"known: {', '.join(known)}")
        text = f"there is no base calculator `{choice.name}`"
        return [CalculatorFault("calculator-unknown", text, robot.span, hint=hint)]
    except Exception as fault:
        text = f"base calculator `{choice.name}` cannot be loaded: {fault or type(fault).__name__}"
        hint = "install its package again, or ask those who made it"
        return [CalculatorFault("calculator-unknown", text, robot.span, hint=hint)]
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
