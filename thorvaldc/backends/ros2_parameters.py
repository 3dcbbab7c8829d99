"""ROS 2 parameter files that every reader reads alike.

rcl's own parser is stricter than YAML in places (no aliases, no nested or mixed
lists, no empty values) and guesses in others (``y`` is true, ``017`` is 15, a bare
``1e3`` a number).  What is written here leaves nothing to guess: text is always
in double quotes, floats always have a dot, lists have one type and are not empty.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence

Scalar = bool | int | float | str
Value = Scalar | Sequence[Scalar] | Mapping[str, "Value"]

HEADER = "# Made by thorvaldc from the robot's file; changes here are lost.\n"

_NODE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*/?[A-Za-z_][A-Za-z0-9_]*")
_PLAIN_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# Words that one YAML reader or another takes for something else than text.
_WORDS = frozenset(
    ["y", "n", "yes", "no", "on", "off", "true", "false", "null", "nan", "inf", "infinity"]
)
# JSON leaves these as they are; in YAML they end a line or are not allowed.
_UNSAFE = re.compile("[\x7f-\xa0\u2028\u2029\ufeff\ufffe\uffff]")
_INT64 = 1 << 63


class ParameterError(ValueError):
    """A value that a ROS 2 parameter file cannot hold; the message says which."""


def parameter_file(nodes: Mapping[str, Mapping[str, Value]]) -> str:
    """The text of a parameter file.

    ``nodes`` maps a node's name, with its name space as in ``/r1/base_driver``, to
    its parameters; a mapping among them groups names (``a.b``).  Raises
    ``ParameterError`` for values that rcl rejects or misreads.
    """
    lines = [HEADER]
    for node, parameters in nodes.items():
        if not _NODE.fullmatch(node):
            raise ParameterError(f"`{node}` is no name of a ROS node")
        lines.append(f"{node}:\n  ros__parameters:\n")
        _write(lines, parameters, 2, node)
    return "".join(lines)


def _write(lines: list[str], group: Mapping[str, Value], depth: int, where: str) -> None:
    if not group:
        raise ParameterError(f"`{where}` has no parameters")
    for name, value in group.items():
        place = f"{where}.{name}"
        key = _key(name)
        if isinstance(value, Mapping):
            lines.append(f"{'  ' * depth}{key}:\n")
            _write(lines, value, depth + 1, place)
        else:
            lines.append(f"{'  ' * depth}{key}: {_value(value, place)}\n")


def _key(name: str) -> str:
    if _PLAIN_KEY.fullmatch(name) and name.lower() not in _WORDS:
        return name
    return quoted(name)


def _value(value: Value, place: str) -> str:
    if isinstance(value, str) or not isinstance(value, Sequence):
        return _scalar(value, place)
    if not value:
        raise ParameterError(f"`{place}` is an empty list, which has no type")
    if len({type(item) for item in value}) > 1:
        raise ParameterError(f"`{place}` mixes types in a list")
    return f"[{', '.join(_scalar(item, place) for item in value)}]"


def _scalar(value: object, place: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        if not -_INT64 <= value < _INT64:
            raise ParameterError(f"`{place}` does not fit into 64 bits: {value}")
        return str(value)
    if isinstance(value, float):
        return real(value, place)
    if isinstance(value, str):
        return quoted(value)
    raise ParameterError(f"`{place}` is {value!r}, which is no parameter value")


def real(value: float, place: str = "value") -> str:
    """Shortest text that reads back equal, always with a dot; what is denormal becomes 0."""
    if not math.isfinite(value):
        raise ParameterError(f"`{place}` is not finite: {value}")
    if abs(value) < sys.float_info.min:  # strtod reports these as out of range
        return "0.0"
    text = repr(value)
    mantissa, e, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{e}{exponent}"


def quoted(text: str) -> str:
    """Text in double quotes with JSON's escapes, which YAML shares."""
    found = json.dumps(text, ensure_ascii=False)
    return _UNSAFE.sub(lambda match: f"\\u{ord(match[0]):04x}", found)
