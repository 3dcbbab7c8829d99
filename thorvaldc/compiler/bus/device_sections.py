"""Data classes for the CAN devices of a robot, and functions that read their `can` sections."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source import node as source
from thorvaldc.diagnostics import Span
from thorvaldc.model import Actuator, FrameDefinition, Node

MASTER = "master"
MASTER_ID = 127
MASTER_HEARTBEAT_PERIOD = 0.1  # s


class Wire(NamedTuple):
    """The connection of a motor to a channel of a motor controller.

    - ``channel``: name of the channel.
    - ``actuator``: the motor with its gear.
    - ``lower``, ``upper``: limits of the joint in rad, or ``None`` for a joint without limits.
    - ``span``: source span of the entry under ``channels`` in the robot file.
    """

    channel: str
    actuator: Actuator
    lower: float | None
    upper: float | None
    span: Span


class Device(NamedTuple):
    """A module of the robot whose module document has a section `can`.

    - ``path``: path of the module instance in the robot.
    - ``name``: name of the device on the bus.
    - ``can``: section `can` of the module type.
    - ``channels``: section `channels` of the module type.
    - ``wires``: connections of motors to the channels.
    - ``address``: entry `can` of the module instance in the robot file.  The value of the entry
      `can` is an id, the word ``auto`` or a mapping.
    - ``scope``: names and values for expressions in the module document.
    - ``span``: source span of the module instance in the robot file.
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
    """A device on a CAN bus, with its node id.

    - ``path``: path of the module instance in the robot.
    - ``bus``: name of the bus.
    - ``span``: source span of the address of the device in the robot file.
    - ``serial_span``: source span of the serial number in the robot file.
    - ``node``: node of the device in the model.
    - ``frames``: CAN frames of the device.
    - ``module_span``: source span of the section `can` in the module document.
    """

    path: str
    bus: str
    span: Span
    serial_span: Span
    node: Node
    frames: tuple[FrameDefinition, ...]
    module_span: Span


class BusSpec(NamedTuple):
    """A CAN bus of the robot.

    - ``bitrate``: bitrate in bit/s.
    - ``span``: source span of the bus in the robot file.
    - ``stated``: whether the robot file contains the bitrate.
    """

    name: str
    bitrate: int
    span: Span
    stated: bool = True


def entries(node: source.Node | None) -> list[tuple[str, source.Node]]:
    """Returns the keys and values of a YAML mapping, or an empty list for other values."""
    return list(node.value.items()) if node is not None and isinstance(node.value, dict) else []


def items(node: source.Node | None) -> tuple[source.Node, ...]:
    """Returns the elements of a YAML list, or an empty tuple if ``node`` is not a list."""
    return node.value if node is not None and isinstance(node.value, tuple) else ()


def integer(scope: Scope, node: source.Node | None, default: int) -> int:
    """Returns a YAML value as a whole number.

    If the YAML value is missing or is not a whole number, returns ``default``.
    """
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
    """Returns a hint for an error message that lists the known names."""
    names = ", ".join(f"`{name}`" for name in known)
    return f"there are {names}" if names else "there are none"
