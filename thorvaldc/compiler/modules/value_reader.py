"""Reads values of a document, evaluates expressions and converts quantities to SI units.

Each method of the class ``ValueReader`` returns a value of the requested type.  If a value in the
document is invalid, the method reports an error and returns the default value.  One run of the
compiler can therefore report all errors of a document.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.compiler.modules.plausible_numbers import probable_unit
from thorvaldc.compiler.source.expressions import ExpressionError, evaluate
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_quantity
from thorvaldc.diagnostics import Proposal, Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model.spatial import Pose, Vec3

# Least and greatest absolute value of every physical quantity in SI units, except 0.  Squares and
# products of two quantities within the bounds do not overflow.
LARGEST = 1e12
SMALLEST = 1e-15
FULL_TURN = 2.0 * math.pi  # rad

INVALID: Any = object()
"""Placeholder for an invalid value whose error has been reported."""


class ReferenceCycleError(Exception):
    """Exception: the value of a parameter depends on itself."""


class InvalidNameError(Exception):
    """Exception: an expression uses a parameter with an invalid value.

    The invalid parameter value has already been reported.
    """


def entries(node: Node | None) -> dict[str, Node]:
    """Returns the entries of a YAML mapping, or ``{}`` if the YAML node is missing or not a
    mapping.
    """
    return node.value if node is not None and isinstance(node.value, dict) else {}


def items(node: Node | None) -> tuple[Node, ...]:
    """Returns the elements of a YAML list, or ``()`` if the YAML node is missing or not a list."""
    return node.value if node is not None and isinstance(node.value, tuple) else ()


class ValueReader(Mapping[str, Any]):
    """Reads scalars, quantities, vectors and poses of a document.

    A ``ValueReader`` is a mapping of the names that expressions may use.  A plain ``ValueReader``
    contains no names.  The subclass ``Scope`` contains the parameters of a module.
    """

    on_robot = False
    """``True`` if the quantities describe a robot, not its surroundings."""

    def __init__(self, report: Report) -> None:
        self.report = report

    def __getitem__(self, name: str) -> Any:
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0

    def value(self, node: Node) -> Any:
        """Returns the value of a YAML node, or the result of the expression in the YAML node.

        Returns ``INVALID`` if the YAML node or the expression has an error.  Returns ``None`` for a
        module parameter with the value `none`.
        """
        value = node.value
        if value is None:
            return INVALID  # The schema check has already reported the invalid value.
        if not (isinstance(value, str) and value.startswith("${") and value.endswith("}")):
            return value
        try:
            return evaluate(value[2:-1], self)
        except ExpressionError as error:
            hint = error.hint
            if isinstance(hint, Proposal) and hint.word:
                whole = hint.within(value)
                hint = Proposal(hint, *(f'"{text}"' for text in whole.replacements))
            self.report.add(error.code, error.message, node.span, hint=hint)
        except ReferenceCycleError as error:
            self.report.add("expression-cycle", f"the value needs {error}", node.span)
        except InvalidNameError:
            pass
        return INVALID

    def evaluate(self, node: Node) -> Any:
        """Returns the value of a YAML node, or ``None`` if the value is invalid."""
        value = self.value(node)
        return None if value is INVALID else value

    def quantity(self, node: Node | None, quantity: str, default: float = 0.0) -> float:
        """Returns a physical quantity in SI units.

        Returns the default value if the YAML node is missing or invalid.  ``quantity``: kind of
        quantity, such as ``length``.
        """
        if node is None:
            return default
        return self._to_si(self.value(node), node, quantity, default)

    def _to_si(self, value: Any, node: Node, quantity: str, default: float) -> float:
        """Converts a number or a text with a unit to a number in SI units."""
        if value is INVALID:
            return default
        if isinstance(value, bool):
            pass
        elif isinstance(value, int | float):
            if node.value == value:
                self._judge_bare_number(value, node, quantity)
            return self._bounded(value, node, default)
        elif isinstance(value, str):
            try:
                return self._bounded(parse_quantity(value, quantity), node, default)
            except UnitError as error:
                self.report.add(error.code, error.message, node.span, hint=error.hint)
                return default
        self._report_type(f"a {quantity.replace('_', ' ')}", node)
        return default

    def _judge_bare_number(self, value: float, node: Node, quantity: str) -> None:
        """Warns of a number without a unit that was probably not meant in SI units."""
        if quantity == "angle" and abs(value) > FULL_TURN:
            self.report.add(
                "angle-in-radians",
                f"`{value:g}` without a unit is an angle of {value:g} rad, more than a full turn",
                node.span,
                hint=Proposal(
                    f"write `{value:g} deg` if degrees are meant, else `{value:g} rad`",
                    f"{value:g} deg",
                    f"{value:g} rad",
                ),
            )
        unit = probable_unit(value, quantity, on_robot=self.on_robot)
        if unit:
            kind = QUANTITIES[quantity]
            number = f"{value:.12g}"
            self.report.add(
                "number-without-unit",
                f"`{number}` without a unit is {kind} of {number} {kind.unit}, which is unusual "
                f"{'on a robot' if self.on_robot else 'in a scenario'}",
                node.span,
                hint=Proposal(
                    f"write `{number} {unit}` if {unit} is meant, else `{number} {kind.unit}`",
                    f"{number} {unit}",
                    f"{number} {kind.unit}",
                ),
            )

    def _bounded(self, value: float, node: Node, default: float) -> float:
        """Returns the physical quantity, or the default value if the quantity is too small or too
        large for a robot.
        """
        if value == 0.0 or SMALLEST <= abs(value) <= LARGEST:
            return float(value)
        self.report.add(
            "number-out-of-range",
            f"{describe_value(node, value)} is too {'small' if abs(value) < 1 else 'large'} "
            f"for a robot; numbers are from {SMALLEST:g} to {LARGEST:g} in SI units",
            node.span,
        )
        return default

    def boolean(self, node: Node | None, default: bool) -> bool:
        """Returns the boolean value of a YAML node, or the default if the node is missing or
        invalid.
        """
        if node is None:
            return default
        value = self.value(node)
        if isinstance(value, bool):
            return value
        if value is not INVALID:
            self._report_type("`true` or `false`", node)
        return default

    def text(self, node: Node | None, default: str = "") -> str:
        """Returns the text of a YAML node, or the default if the node is missing or invalid."""
        if node is None:
            return default
        value = self.value(node)
        if isinstance(value, str):
            return value
        if value is not INVALID:
            self._report_type("text", node)
        return default

    def vector(self, node: Node | None, quantity: str, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
        """Returns three physical quantities in SI units.

        The YAML node contains a list of three quantities, or an expression with a list as the
        result.
        """
        if node is None:
            return default
        if isinstance(node.value, str):
            value = self.value(node)
            if value is INVALID:
                return default
            if isinstance(value, tuple | list) and len(value) == 3 and all(map(_is_number, value)):
                x, y, z = (self._bounded(v, node, 0.0) for v in value)
                return (x, y, z)
        elements = items(node)
        if len(elements) != 3:
            self.report.add("wrong-type", "expected three numbers: x, y and z", node.span)
            return default
        x, y, z = (self.quantity(element, quantity) for element in elements)
        return (x, y, z)

    def pose(self, node: Node) -> Pose:
        """Returns the pose that the keys `xyz` (m) and `rpy` (rad) of a mapping describe."""
        return Pose.from_xyz_rpy(
            self.vector(node.get("xyz"), "length"), self.vector(node.get("rpy"), "angle")
        )

    def _report_type(self, expected: str, node: Node) -> None:
        self.report.add("wrong-type", f"expected {expected}, got {describe_node(node)}", node.span)


def describe_node(node: Node) -> str:
    """Describes the value of a YAML node for an error message."""
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, bool):
        return f"`{str(node.value).lower()}`"
    return f"`{node.value}`"


def describe_value(node: Node, value: Any) -> str:
    """Describes the value of a YAML node for an error message.

    The description of an expression includes the value of the expression.
    """
    if isinstance(node.value, str) and "${" in node.value and isinstance(value, int | float):
        return f"{plain(value)} (`{node.value}`)"
    return describe_node(node)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
