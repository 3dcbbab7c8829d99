"""Reads quantities that must lie within bounds, from documents without expressions."""

from __future__ import annotations

import math

from thorvaldc.compiler.modules.value_reader import ValueReader, items
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model import Pose


class BoundedQuantities:
    """Reads quantities in SI; reports those that are out of bounds and returns the default."""

    def __init__(self, scope: ValueReader, report: Report) -> None:
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
        """Returns the value of ``key``, from ``least`` to ``most``.

        If ``above`` is true, it must be more than ``least``.
        """
        entry = node.get(key)
        if entry is None:
            return default
        value = self.scope.quantity(entry, quantity, default)
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
            entry.span,
        )
        return default

    def positive(self, node: Node, key: str, quantity: str, default: float) -> float:
        """Returns the value of ``key``, which must be more than 0."""
        return self(node, key, quantity, default, least=0.0, above=True)

    def pair(self, node: Node, key: str, default: tuple[float, float]) -> tuple[float, float]:
        """Returns a list of two lengths (m)."""
        elements = items(node.get(key))
        if len(elements) != 2:
            return default
        x, y = (self.scope.quantity(element, "length") for element in elements)
        return x, y

    def planar_pose(self, node: Node) -> Pose:
        """Returns the pose of the keys `xyz` (m) and `yaw` (rad, reduced to -pi..pi)."""
        yaw = math.remainder(self.scope.quantity(node.get("yaw"), "angle"), 2 * math.pi)
        xyz = self.scope.vector(node.get("xyz"), "length")
        return Pose.from_xyz_rpy(xyz, (0.0, 0.0, yaw)).clean()
