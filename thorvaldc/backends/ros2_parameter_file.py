"""Writes ROS 2 parameter files that every YAML reader reads in the same way.

The YAML parser of ROS 2 (rcl) rejects aliases, nested or mixed lists and empty values. The YAML
parser of ROS 2 (rcl) guesses the type of some values: ``y`` is true, ``017`` is 15, and ``1e3`` is
a number. The YAML writer therefore puts all text in double quotes and writes every float with a
dot. The YAML writer rejects empty lists and lists with mixed types.
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
# Words that some YAML readers read as a truth value, a number or null instead of text.
_WORDS = frozenset(
    ["y", "n", "yes", "no", "on", "off", "true", "false", "null", "nan", "inf", "infinity"]
)
# Characters that end a line or are forbidden in YAML, and that a JSON encoder does not escape.
_UNSAFE = re.compile("[\x7f-\xa0\u2028\u2029\ufeff\ufffe\uffff]")
_INT64 = 1 << 63


class ParameterError(ValueError):
    """A value that a ROS 2 parameter file cannot contain. The error message contains the name of
    the ROS 2 parameter."""


def parameter_file(nodes: Mapping[str, Mapping[str, Value]]) -> str:
    """Return the text of a ROS 2 parameter file.

    ``nodes`` maps the full name of each ROS 2 node, such as ``/r1/base_driver``, to the parameters
    of the node. A nested dictionary is a group of ROS 2 parameters: ``{"a": {"b": 1}}`` is the
    parameter ``a.b``. Raises ``ParameterError`` for a value that rcl, the YAML parser of ROS 2,
    rejects or misreads.
    """
    lines = [HEADER]
    for node, parameters in nodes.items():
        if not _NODE.fullmatch(node):
            raise ParameterError(f"`{node}` is no name of a ROS node")
        lines.append(f"{node}:\n  ros__parameters:\n")
        _write(lines, parameters, 2, node)
    return "".join(lines)


def _write(lines: list[str], group: Mapping[str, Value], depth: int, path_of_group: str) -> None:
    if not group:
        raise ParameterError(f"`{path_of_group}` has no parameters")
    for name, value in group.items():
        path = f"{path_of_group}.{name}"
        key = _key(name)
        if isinstance(value, Mapping):
            lines.append(f"{'  ' * depth}{key}:\n")
            _write(lines, value, depth + 1, path)
        else:
            lines.append(f"{'  ' * depth}{key}: {_value(value, path)}\n")


def _key(name: str) -> str:
    if _PLAIN_KEY.fullmatch(name) and name.lower() not in _WORDS:
        return name
    return quoted(name)


def _value(value: Value, path: str) -> str:
    if isinstance(value, str) or not isinstance(value, Sequence):
        return _scalar(value, path)
    if not value:
        raise ParameterError(f"`{path}` is an empty list, which has no type")
    if len({type(item) for item in value}) > 1:
        raise ParameterError(f"`{path}` mixes types in a list")
    return f"[{', '.join(_scalar(item, path) for item in value)}]"


def _scalar(value: object, path: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        if not -_INT64 <= value < _INT64:
            raise ParameterError(f"`{path}` does not fit into 64 bits: {value}")
        return str(value)
    if isinstance(value, float):
        return real(value, path)
    if isinstance(value, str):
        return quoted(value)
    raise ParameterError(f"`{path}` is {value!r}, which is no parameter value")


def real(value: float, path: str = "value") -> str:
    """Return the shortest text with a decimal point that reads back as the same float.

    Denormal floating-point numbers become 0.0. Raises ``ParameterError`` for NaN and infinite
    numbers.
    """
    if not math.isfinite(value):
        raise ParameterError(f"`{path}` is not finite: {value}")
    if abs(value) < sys.float_info.min:  # strtod reports denormal numbers as out of range
        return "0.0"
    text = repr(value)
    mantissa, e, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{e}{exponent}"


def quoted(text: str) -> str:
    """Return the text in double quotes with JSON's escape sequences, which are also valid in
    YAML."""
    escaped = json.dumps(text, ensure_ascii=False)
    return _UNSAFE.sub(lambda match: f"\\u{ord(match[0]):04x}", escaped)
