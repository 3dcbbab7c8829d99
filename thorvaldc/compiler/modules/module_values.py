"""Reads values of one module document: link names, sizes, conditions and properties."""

from __future__ import annotations

import contextlib

from thorvaldc.compiler.library import ModuleType
from thorvaldc.compiler.modules.scope import Scope, hint_of_known
from thorvaldc.compiler.modules.value_reader import entries
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics import Report
from thorvaldc.model.robot import Scalar


class ModuleValues:
    """Values of a module document with the parameter values of ``scope``."""

    def __init__(self, module: ModuleType, scope: Scope, report: Report) -> None:
        self.module = module
        self.scope = scope
        self.report = report
        links = module.section("links")
        self.link_names = [name for name, node in links.items() if self.is_present(node)]

    def is_present(self, node: Node) -> bool:
        """Evaluates the condition `when`; by default the part is present."""
        return self.scope.boolean(node.get("when"), True)

    def link_name(self, node: Node | None) -> str:
        """Returns the link that a key names; the first link if the key is missing or unknown."""
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
        """Returns a quantity in SI that is 0 or more; by default 0."""
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
        """Returns a quantity in SI that is more than 0."""
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
        """Returns a value of any type; text with a unit becomes a number in SI."""
        value = self.scope.evaluate(node)
        if isinstance(value, str) and not node.quoted:
            with contextlib.suppress(UnitError):
                return parse_any(value)
        return value if isinstance(value, bool | int | float | str) else 0.0

    def properties(self, node: Node | None) -> tuple[tuple[str, Scalar], ...]:
        """Returns the names and values of a mapping; quantities are in SI."""
        return tuple((key, self.scalar(value)) for key, value in entries(node).items())
