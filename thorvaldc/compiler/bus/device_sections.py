"""Devices of a robot as the elaboration hands them over, and readers of their sections."""

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
    """A motor on a channel.  ``lower`` and ``upper`` (rad) limit its joint, if anything does.

    ``span`` is the place that connects the two.
    """

    channel: str
    actuator: Actuator
    lower: float | None
    upper: float | None
    span: Span


class Device(NamedTuple):
    """A module with a `can` section in its place, as the elaboration found it.

    ``can`` and ``channels`` are those sections of the module; ``address`` is what
    the robot says under `can` of the module (an id, ``auto``, a mapping, or
    ``None``); ``span`` the module's place in the robot's file.
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
    """A device with its id: ``span`` is the place of its address in the robot's file.

    ``serial_span`` is that of its serial number; ``module_span`` is what says what
    such a device is, its `can` section.
    """

    path: str
    bus: str
    span: Span
    serial_span: Span
    node: Node
    frames: tuple[FrameDefinition, ...]
    module_span: Span


class BusSpec(NamedTuple):
    """A bus as the robot declares it: ``bitrate`` in bit/s, ``stated`` if the file gives it."""

    name: str
    bitrate: int
    span: Span
    stated: bool = True


def entries(node: source.Node | None) -> list[tuple[str, source.Node]]:
    """The entries of a mapping, none where there is no mapping."""
    return list(node.value.items()) if node is not None and isinstance(node.value, dict) else []


def items(node: source.Node | None) -> tuple[source.Node, ...]:
    """The items of a list, none where there is no list."""
    return node.value if node is not None and isinstance(node.value, tuple) else ()


def integer(scope: Scope, node: source.Node | None, default: int) -> int:
    """A whole number, or ``default`` where it is left out or at fault."""
    if node is None:
        return default
    if type(node.value) is int:
        return node.value
    value = scope.quantity(node, "ratio", float(default))
    if not value.is_integer():
        scope.report.add("wrong-type", f"a whole number is wanted, not `{value:g}`", node.span)
        return default
    return int(value)


def listed(known: Iterable[str]) -> str:
    """A hint with all that could have been meant."""
    names = ", ".join(f"`{name}`" for name in known)
    return f"there are {names}" if names else "there are none"
