"""Robots whose files contain less."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from thorvaldc.model import Node, Robot


def without_serials(robot: Robot, names: Sequence[str]) -> Robot:
    """Returns the robot without the serial numbers of these nodes."""
    bus = robot.buses[0]
    nodes = tuple(_without_serial(node) if node.name in names else node for node in bus.nodes)
    return dataclasses.replace(robot, buses=(dataclasses.replace(bus, nodes=nodes),))


def _without_serial(node: Node) -> Node:
    objects = tuple(
        dataclasses.replace(o, value=None) if (o.index, o.subindex) == (0x1018, 4) else o
        for o in node.objects
    )
    return dataclasses.replace(node, serial=None, objects=objects)
