"""Reads physical quantities from a document and checks that each quantity is within bounds."""

from __future__ import annotations

import math

from thorvaldc.compiler.modules.value_reader import ValueReader, items
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Pose


class BoundedQuantities:
    """Reads physical quantities from a document and converts the values to SI units.

    A quantity that is out of bounds is reported and replaced by the default value.
    """

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
        """Returns the physical quantity of a key in SI units, or the default value if the key is
        missing.

        Parameters
        ----------
        node : mapping that contains the key.
        quantity : kind of quantity, such as ``length``.
        least : lower bound of the value.
        most : upper bound of the value.
        above : if true, the value must be greater than ``least``.  If false, the value may equal
            ``least``.
        """
        entry = node.get(key)
        if entry is None:
            return default
        value = self.scope.quantity(entry, quantity, default)
        if least <= value <= most and not (above and value == least):
            return value
        bounds = []
        if least > -math.inf:
            bounds.append(f"{'more than' if above else 'at least'} {plain(least)}")
        if most < math.inf:
            bounds.append(f"at most {plain(most)}")
        self.report.add(
            "out-of-range",
            f"`{key}` is {plain(value)} in SI units; it must be {' and '.join(bounds)}",
            entry.span,
        )
        return default

    def positive(self, node: Node, key: str, quantity: str, default: float) -> float:
        """Returns the physical quantity of a key in SI units, and checks that the quantity is
        positive.
        """
        return self(node, key, quantity, default, least=0.0, above=True)

    def pair(self, node: Node, key: str, default: tuple[float, float]) -> tuple[float, float]:
        """Returns two lengths (m) from the list that is the value of a key.

        Returns the default lengths if the list does not have exactly two elements.
        """
        elements = items(node.get(key))
        if len(elements) != 2:
            return default
        x, y = (self.scope.quantity(element, "length") for element in elements)
        return x, y

    def planar_pose(self, node: Node) -> Pose:
        """Returns the pose that the keys `xyz` (m) and `yaw` (rad) of a mapping describe.

        The yaw angle is reduced to the range -pi to pi.
        """
        yaw = math.remainder(self.scope.quantity(node.get("yaw"), "angle"), 2 * math.pi)
        xyz = self.scope.vector(node.get("xyz"), "length")
        return Pose.from_xyz_rpy(xyz, (0.0, 0.0, yaw)).clean()
