"""Reads link names, sizes, conditions and properties from a module document."""

from __future__ import annotations

import contextlib

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope, hint_of_known
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report
from thorvaldc.model import Scalar
from thorvaldc.schema.documents import inlined


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

    def section(self, node: Node, key: str, alternative: int = 0) -> Section:
        """Returns an entry of a section of the module document such as `motors`, or the section
        itself, with its values in SI units.

        ``alternative``: as for ``Section``.
        """
        schema = inlined("module")["properties"][key]
        entry_schema = schema.get("additionalProperties") or schema
        return Section(node, entry_schema, self.scope, alternative)

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
