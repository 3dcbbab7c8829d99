"""The devices of a robot before their buses are built, and readers of their sections."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source import node as source
from thorvaldc.diagnostics import Span
from thorvaldc.model.robot import Actuator, FrameDefinition, Node

MASTER = "master"
MASTER_ID = 127
MASTER_HEARTBEAT_PERIOD = 0.1  # s
CANOPEN = "canopen"


class Wire(NamedTuple):
    """A motor on a channel.  ``lower`` and ``upper`` (rad) limit its joint; ``None``: no limit.

    ``span`` is that of the entry that connects the two.
    """

    channel: str
    actuator: Actuator
    lower: float | None
    upper: float | None
    span: Span


class Device(NamedTuple):
    """A module instance with a `can` section.

    ``can`` and ``channels`` are these sections of the module type.  ``address`` is the `can` entry
    of the module in the robot's file: an id, ``auto``, a mapping, or ``None``.  ``span`` is that of
    the module in the robot's file.
    """

    path: str
    name: str
    can: source.Node
    channels: source.Node | None
    wires: tuple[Wire, ...]
    address: source.Node | None
    scope: Scope
    span: Span


class Placed(NamedTuple):
    """A device with its node id.

    ``span`` is that of its address in the robot's file, ``serial_span`` that of its serial number,
    ``module_span`` that of the `can` section of its module type.
    """

    path: str
    bus: str
    span: Span
    serial_span: Span
    node: Node
    frames: tuple[FrameDefinition, ...]
    module_span: Span


class BusSpec(NamedTuple):
    """A bus in the robot's file.  ``bitrate`` is in bit/s; ``stated``: the file contains it."""

    name: str
    bitrate: int
    span: Span
    stated: bool = True


def entries(node: source.Node | None) -> list[tuple[str, source.Node]]:
    """Return the entries of a mapping; none if the node is no mapping."""
    return list(node.value.items()) if node is not None and isinstance(node.value, dict) else []


def items(node: source.Node | None) -> tuple[source.Node, ...]:
    """Return the items of a list; none if the node is no list."""
    return node.value if node is not None and isinstance(node.value, tuple) else ()


def integer(scope: Scope, node: source.Node | None, default: int) -> int:
    """Return a whole number, or ``default`` if it is missing or invalid."""
    if node is None:
        return default
    if type(node.value) is int:
        return node.value
    value = scope.quantity(node, "ratio", float(default))
    if not value.is_integer():
        scope.report.add("wrong-type", f"expected a whole number, found `{value:g}`", node.span)
        return default
    return int(value)


def listed(known: Iterable[str]) -> str:
    """Return a hint that lists the known names."""
    names = ", ".join(f"`{name}`" for name in known)
    return f"there are {names}" if names else "there are none"
