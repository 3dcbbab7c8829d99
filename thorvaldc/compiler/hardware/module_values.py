"""Reads link names, sizes, conditions and properties from a module document."""

from __future__ import annotations

import contextlib

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report
from thorvaldc.model.robot import Scalar


class ModuleValues:
    """Reader of conditions, sizes and properties in a module document.

    Expressions in the module document use the parameter values in ``scope``.
    """

    def __init__(self, module: ModuleType, scope: Scope, report: Report) -> None:
        self.module = module
        self.scope = scope
        self.report = report
        links = module.section("links")
        self.link_names = [name for name, node in links.items() if self.is_present(node)]

    def is_present(self, node: Node) -> bool:
        """Returns the value of the condition `when`, or true if there is no condition."""
        return self.scope.boolean(node.get("when"), True)

    def link_name(self, node: Node | None) -> str:
        """Returns the link name that a node of a module document contains.

        If the module document contains no link name, the name of the first link is returned.  A
        link name that the module document does not define is reported.
        """
        first = self.link_names[0] if self.link_names else ""
        if node is None:
            return first
        name = self.scope.text(node)
        if name in self.link_names:
            return name
        if name:
            self.report.add(
                "link-unknown",
                f"`{self.module.name}` has no link `{name}`",
                node.span,
                hint=hint_of_known(name, self.link_names),
            )
        return name or first

    def not_negative(self, node: Node, key: str, quantity: str) -> float:
        """Returns the physical quantity of a key in SI units, and checks that the quantity is not
        negative.

        Returns 0 if the key is missing or the physical quantity is negative.
        """
        entry = node.get(key)
        value = self.scope.quantity(entry, quantity)
        if value < 0 and entry is not None:
            self.report.add(
                "size-not-positive",
                f"`{key}` is {QUANTITIES[quantity].format_value(value)}; it must not be negative",
                entry.span,
            )
        return max(value, 0.0)

    def positive(self, node: Node, key: str, quantity: str, default: float) -> float:
        """Returns the physical quantity of a key in SI units, and checks that the quantity is
        positive.

        Returns the default value if the key is missing or the physical quantity is not valid.
        """
        entry = node.get(key)
        value = self.scope.quantity(entry, quantity, default)
        if value > 0:
            return value
        if entry is not None:
            self.report.add(
                "size-not-positive",
                f"`{key}` is {QUANTITIES[quantity].format_value(value)}; it must be positive",
                entry.span,
            )
        return default

    def scalar(self, node: Node) -> Scalar:
        """Returns the value of a YAML node as a boolean, a number or a text.

        A text with a unit is converted to a number in SI units.
        """
        value = self.scope.evaluate(node)
        if isinstance(value, str) and not node.quoted:
            with contextlib.suppress(UnitError):
                return parse_any(value)
        return value if isinstance(value, bool | int | float | str) else 0.0

    def properties(self, node: Node | None) -> tuple[tuple[str, Scalar], ...]:
        """Returns the properties in a mapping of a module document, by name.

        Properties with a unit are converted to SI units.
        """
        return tuple((key, self.scalar(value)) for key, value in entries(node).items())
