"""Reads values of a document, evaluates expressions and converts quantities to SI units.

Each method of the class ``ValueReader`` returns a value of the requested type.  If a value in the
document is invalid, the method reports an error and returns the default value.  One run of the
compiler can therefore report all errors of a document.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.compiler.source import dimensions
from thorvaldc.compiler.source.expression_parser import ExpressionError
from thorvaldc.compiler.source.expressions import evaluate, expression_of
from thorvaldc.compiler.source.node import Node, describe_node, whole_number_hint
from thorvaldc.compiler.source.unit_table import QUANTITIES, Dimension, Quantity
from thorvaldc.compiler.source.units import UnitError, is_bare_number, parse_quantity
from thorvaldc.diagnostics import Proposal, Report
from thorvaldc.model.number_origins import read_at

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
    """Reads scalars and quantities of a document.

    A ``ValueReader`` is a mapping of the names that expressions may use.  A plain ``ValueReader``
    contains no names.  The subclass ``Scope`` contains the parameters of a module.

    ``on_robot``: ``True`` if the quantities describe a robot, not its surroundings.
    """

    def __init__(self, report: Report, *, on_robot: bool = False) -> None:
        self.report = report
        self.on_robot = on_robot
        self._dimensions: dict[str, Any] = {}  # of expressions that were evaluated

    def dimension(self, name: str) -> Any:
        """Returns the dimension of a name, as ``dimensions`` describes it.

        Raises ``KeyError`` if the name is unknown.
        """
        raise KeyError(name)

    def let_node(self, name: str) -> Node | None:
        """Returns the node of a `let` value, or ``None`` if there is none."""
        return None

    def __getitem__(self, name: str) -> Any:
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0

    def value(self, node: Node, quantity: str | None = None) -> Any:
        """Returns the value of a YAML node, or the result of the expression in the YAML node.

        Returns ``INVALID`` if the YAML node or the expression has an error.  Returns ``None`` for a
        module parameter with the value `none`.  ``quantity``: kind of quantity for the hint of a
        wrong dimension inside the expression.
        """
        value = node.value
        if value is None:
            return INVALID  # The schema check has already reported the invalid value.
        text = expression_of(node)
        if text is None:
            return read_at(value, node.span)
        try:
            result = evaluate(text, self)
            if text not in self._dimensions:
                self._dimensions[text] = dimensions.infer_dimension(text, self)
            return read_at(result, node.span)
        except dimensions.DimensionError as error:
            expected = dimensions.EXPECTED[quantity] if quantity is not None else None
            self._report_dimension(
                node, f"{error.message}, in `{value}`", expected, (error.first, error.second)
            )
        except ExpressionError as error:
            hint = error.hint
            if isinstance(hint, Proposal) and hint.word:
                whole = hint.within(str(value))
                hint = Proposal(hint, *(f'"{text}"' for text in whole.replacements))
            self.report.add(error.code, error.message, node.span, hint=hint)
        except ReferenceCycleError as error:
            self.report.add("expression-cycle", f"the value needs {error}", node.span)
        except RecursionError:
            message = "the value needs too many nested values"
            self.report.add("expression-cycle", message, node.span)
        except InvalidNameError:
            pass
        return INVALID

    def _report_dimension(
        self,
        node: Node,
        message: str,
        expected: Dimension | None,
        actual: tuple[Dimension, ...],
        expected_words: str = "",
    ) -> None:
        """Reports a wrong dimension of an expression.

        ``expected`` and all after it: as for ``dimension_hint``.
        """
        if self.report.has_error_in(node.span):
            return  # A part that is repeated 1000 times has 1000 scopes and one error.
        from thorvaldc.compiler.values.dimension_hints import dimension_hint  # of an error only

        text = expression_of(node) or ""
        hint = dimension_hint(self, text, expected, actual, expected_words)
        self.report.add("wrong-dimension", message, node.span, hint=hint)

    def dimension_of(self, node: Node) -> Any:
        """Returns the dimension of the value of a YAML node, whose kind no schema states.

        The value is an expression, a number, a text with a unit, or a list of them.  An expression
        with an error has no dimension.
        """
        text, value = expression_of(node), node.value
        if text is not None:
            if text not in self._dimensions:
                with contextlib.suppress(ExpressionError, ReferenceCycleError, RecursionError):
                    self._dimensions[text] = dimensions.infer_dimension(text, self)
            return self._dimensions.get(text)
        if isinstance(value, tuple):
            return [self.dimension_of(element) for element in value]
        if isinstance(value, str) and not node.quoted:
            return dimensions.written_dimension(value)
        return value if isinstance(value, int | float) and not isinstance(value, bool) else None

    def has_dimension(self, node: Node, *allowed: Dimension, quantity: str) -> bool:
        """Checks the dimension of the number, or of the list of numbers, that an expression gives.

        - ``allowed``: further dimensions that are allowed.
        - ``quantity``: expected kind of quantity.
        """
        part = self._dimensions.get(expression_of(node) or "")
        if part is None or part == dimensions.EXPECTED[quantity]:
            return True
        for element in part if isinstance(part, list) else (part,):
            dimension = dimensions.number_dimension(element)
            expected = (dimensions.EXPECTED[quantity], *allowed)
            if dimension is None or any(dimensions.fits(dimension, kind) for kind in expected):
                continue
            words = " or ".join([str(QUANTITIES[quantity]), *map(dimensions.in_words, allowed)])
            message = f"`{node.value}` is {dimensions.in_words(dimension)}; expected {words}"
            self._report_dimension(node, message, expected[-1], (dimension,), words)
            return False
        return True

    def evaluate(self, node: Node) -> Any:
        """Returns the value of a YAML node, or ``None`` if the value is invalid."""
        value = self.value(node)
        return None if value is INVALID else value

    def quantity(
        self, node: Node | None, quantity: str, default: float = 0.0, *allowed: Dimension
    ) -> float:
        """Returns a physical quantity in SI units.

        Returns the default value if the YAML node is missing or invalid.  ``quantity``: kind of
        quantity, such as ``length``.  ``allowed``: further dimensions that an expression may have.
        """
        if node is None:
            return default
        return self._to_si(self.value(node, quantity), node, quantity, default, *allowed)

    def _to_si(
        self, value: Any, node: Node, quantity: str, default: float, *allowed: Dimension
    ) -> float:
        """Converts a number or a text with a unit to a number in SI units."""
        if value is INVALID:
            return default
        if isinstance(value, bool):
            pass
        elif isinstance(value, int | float):
            if node.value == value:
                self._judge_bare_number(value, node, quantity)
            elif not self.has_dimension(node, *allowed, quantity=quantity):
                return default
            return self._bounded(value, node, default)
        elif isinstance(value, str):
            try:
                number = parse_quantity(value, quantity)
                if value[-1] in "0123456789. " and is_bare_number(value):
                    self._judge_bare_number(number, node, quantity)
                return self._bounded(number, node, default)
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
            return read_at(value * 1.0, node.span)
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
        value: bool = INVALID if node is None else self.of_type(bool, node)
        return default if value is INVALID else value

    def text(self, node: Node | None, default: str = "") -> str:
        """Returns the text of a YAML node, or the default if the node is missing or invalid."""
        value: str = INVALID if node is None else self.of_type(str, node)
        return default if value is INVALID else value

    def of_type(self, kind: type[bool] | type[str], node: Node) -> Any:
        """Returns a boolean or a text, or ``INVALID`` if the YAML node has another value."""
        value = self.value(node)
        if value is INVALID or isinstance(value, kind):
            return value
        self._report_type("text" if kind is str else "`true` or `false`", node)
        return INVALID

    def numbers(self, node: Node, quantity: str, count: int, *allowed: Dimension) -> Any:
        """Returns the physical quantities in SI units that an expression gives, or ``INVALID``.

        - ``count``: length of the list.
        - ``allowed``: further dimensions that the expression may have.
        """
        value = self.value(node, quantity)
        if value is INVALID:
            return INVALID
        if isinstance(value, tuple | list) and len(value) == count and all(map(_is_number, value)):
            if not self.has_dimension(node, *allowed, quantity=quantity):
                return INVALID
            return tuple(self._bounded(number, node, 0.0) for number in value)
        expected = "three numbers: x, y and z" if count == 3 else f"{count} numbers"
        self.report.add("wrong-type", f"expected {expected}", node.span)
        return INVALID

    def _report_type(self, expected: str, node: Node) -> None:
        hint = whole_number_hint(node) if expected == "a whole number" else None
        message = f"expected {expected}, got {describe_node(node)}"
        self.report.add("wrong-type", message, node.span, hint=hint)


def describe_value(node: Node, value: Any, quantity: Quantity = QUANTITIES["number"]) -> str:
    """Describes the value of a YAML node for an error message.

    The description of an expression includes the value of the expression.
    """
    if isinstance(node.value, str) and "${" in node.value and isinstance(value, int | float):
        return f"{quantity.format_value(value)} (`{node.value}`)"
    return describe_node(node)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


# -- numbers without a unit that were probably meant in another unit, such as mm ----

_USUAL: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "length": (0.0, 20.0, ("mm",)),
    "mass": (0.0, 5_000.0, ("g",)),
    "time": (0.0, 60.0, ("ms",)),
    "velocity": (0.0, 30.0, ("mm/s", "km/h")),
    "acceleration": (0.0, 100.0, ("mm/s^2",)),
    "angular_velocity": (0.0, 2_000.0, ("rpm",)),
    "torque": (0.0, 20_000.0, ("N mm",)),
    "voltage": (0.0, 1_500.0, ("mV",)),
    "current": (0.0, 2_000.0, ("mA",)),
    "density": (20.0, math.inf, ("g/cm^3",)),
}
"""Least and largest usual value on a robot in SI units, and the units of other numbers.

The largest values are above those of large field robots, with a length of 10 m and a mass of 2 t.
"""


_USUAL_IN_SCENARIO: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "length": (0.0, 1_000.0, ("mm",)),
    "time": (0.0, 14_400.0, ("ms",)),
    "velocity": (0.0, 30.0, ("mm/s", "km/h")),
    "angular_velocity": (0.0, 20.0, ("deg/s", "rpm")),
    "energy": (0.0, math.inf, ()),
}
"""Values as in ``_USUAL`` of numbers in fleets and scenarios: places, commands and durations."""


def probable_unit(value: float, quantity: str, *, on_robot: bool = True) -> str:
    """Returns the unit in which a number was probably meant, or an empty text if it is SI.

    - ``value``: number without a unit, which the compiler takes in SI units.
    - ``quantity``: kind of quantity, such as ``length``.
    - ``on_robot``: whether the number describes a robot, and not a fleet or scenario.
    """
    table = _USUAL if on_robot else _USUAL_IN_SCENARIO
    least, largest, units = table.get(quantity, (0.0, math.inf, ()))
    size = abs(value)
    if size == 0.0 or least <= size <= largest:
        return ""
    usual = (u for u in units if least <= parse_quantity(f"{size!r} {u}", quantity) <= largest)
    return next(usual, "")
