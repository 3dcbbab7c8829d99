"""Quantities of a document, within bounds."""

from __future__ import annotations

import math

from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Pose


class Numbers:
    """Quantities of a document, each within its bounds."""

    def __init__(self, scope: Scope, report: Report) -> None:
        self.scope = scope
        self.report = report

    def __call__(
        self,
        node: Node,
        key: str,
        quantity: str,
        default: float = 0.0,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        above: bool = False,
    ) -> float:
        """The value of ``key`` in SI; ``above``: it must be more than ``least``."""
        found = node.get(key)
        return self.value(found, key, quantity, default, least=least, most=most, above=above)

    def value(
        self,
        found: Node | None,
        key: str,
        quantity: str,
        default: float = 0.0,
        *,
        least: float = -math.inf,
        most: float = math.inf,
        above: bool = False,
    ) -> float:
        if found is None:
            return default
        value = self.scope.quantity(found, quantity, default)
        if least <= value <= most and not (above and value == least):
            return value
        bounds = []
        if least > -math.inf:
            bounds.append(f"{'more than' if above else 'at least'} {least:g}")
        if most < math.inf:
            bounds.append(f"at most {most:g}")
        self.report.add(
            "out-of-range",
            f"`{key}` is {value:g} in SI units; it must be {' and '.join(bounds)}",
            found.span,
        )
        return default

    def positive(self, node: Node, key: str, quantity: str, default: float) -> float:
        return self(node, key, quantity, default, least=0.0, above=True)

    def pair(self, node: Node, key: str, default: tuple[float, float]) -> tuple[float, float]:
        found = node.get(key)
        items = found.value if found is not None else None
        if not isinstance(items, tuple) or len(items) != 2:
            return default
        x, y = (self.scope.quantity(item, "length") for item in items)
        return x, y


def placed(node: Node, numbers: Numbers) -> Pose:
    """The pose of ``xyz`` and ``yaw``."""
    scope = numbers.scope
    yaw = math.remainder(scope.quantity(node.get("yaw"), "angle"), 2 * math.pi)
    return Pose.from_xyz_rpy(scope.vector(node.get("xyz"), "length"), (0.0, 0.0, yaw)).clean()
