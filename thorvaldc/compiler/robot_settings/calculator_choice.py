"""Reads and checks the base calculator that a robot document chooses."""

from __future__ import annotations

from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Proposal, Report
from thorvaldc.model import CalculatorChoice, Robot


def read_calculator(document: Node, scope: Scope) -> CalculatorChoice:
    """Returns the name and options of the base calculator that the document chooses.

    The default base calculator is ``general``.
    """
    node = document.get("base_calculator")
    if node is None:
        return CalculatorChoice()
    default = CalculatorChoice().name
    if not isinstance(node.value, dict):
        return CalculatorChoice(scope.text(node, default))
    options = node.get("options")
    entries = options.value if options is not None and isinstance(options.value, dict) else {}
    return CalculatorChoice(
        scope.text(node.get("name"), default),
        tuple(
            (key, option.value)
            for key, option in entries.items()
            if isinstance(option.value, bool | int | float | str)
        ),
    )


def check_calculator(robot: Robot, document: Node, report: Report) -> None:
    """Checks the base calculator of a robot.

    The base calculator must exist, accept the chosen options and suit the wheels of the robot.
    """
    if robot.calculator == CalculatorChoice():
        return  # The general base calculator suits every robot.
    # The import of the base calculators is here, because robots with the general base calculator do
    # not need the import.
    from thorvaldc.runtime import calculators

    choice = document.get("base_calculator")
    name = choice.get("name") if choice is not None else None
    options = choice.get("options") if choice is not None else None
    for problem in calculators.calculator_errors(robot):
        option = options.get(problem.option) if options is not None and problem.option else None
        diagnostic = problem.diagnostic
        span = (option or name or choice or document).span
        if option is not None and isinstance(diagnostic.hint, Proposal):
            span = option.where  # the name of the option is misspelled
        report.add(diagnostic.code.name, diagnostic.message, span, hint=diagnostic.hint)
