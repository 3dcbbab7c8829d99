"""A reader of parameter files with the rules of rcl's parser, independent of our writer.

It reads the events of libyaml and tries types in the same order: truth value, integer by
``strtol`` with base 0, real by ``strtod``, else text; a quoted scalar is text.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

TRUE = {"Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
FALSE = {"N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
NAN_INF = re.compile(r"[+-]?(nan|inf|infinity)|[+-]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", re.I)
INTEGER = re.compile(r"[ \t]*[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)")
DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
HEX_REAL = re.compile(r"[+-]?0[xX][0-9a-fA-F]+(\.[0-9a-fA-F]*)?([pP][+-]?[0-9]+)?")
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class RclError(Exception):
    """rcl rejects the file."""


def read(text: str) -> dict[str, dict[str, Any]]:
    """Return the parameters by full node name; nested names are joined with dots."""
    events = list(yaml.parse(text, Loader=yaml.CSafeLoader))
    if any(isinstance(e, yaml.AliasEvent) for e in events):
        raise RclError("will not support aliasing")
    body = iter(events[2:-2])  # stream and document
    if not isinstance(next(body, None), yaml.MappingStartEvent):
        raise RclError("no mapping")
    nodes: dict[str, dict[str, Any]] = {}
    _nodes(body, [], nodes)
    return nodes


def _nodes(events: Any, path: list[str], nodes: dict[str, dict[str, Any]]) -> None:
    for event in events:
        if isinstance(event, yaml.MappingEndEvent):
            return
        key = _scalar_text(event)
        start = next(events)
        if not isinstance(start, yaml.MappingStartEvent):
            raise RclError(f"cannot have a value before ros__parameters: {key}")
        if key == "ros__parameters":
            if not path:
                raise RclError("no node name before ros__parameters")
            _parameters(events, "", nodes.setdefault(_full_name(path), {}))
        else:
            _nodes(events, [*path, key], nodes)


def _full_name(path: list[str]) -> str:
    name = "/".join(path)
    name = name if name.startswith("/") else f"/{name}"
    for part in name[1:].split("/"):
        if not NAME.fullmatch(part):
            raise RclError(f"invalid node name: {name}")
    return name


def _parameters(events: Any, prefix: str, into: dict[str, Any]) -> None:
    for event in events:
        if isinstance(event, yaml.MappingEndEvent):
            return
        name = prefix + _scalar_text(event)
        value = next(events)
        if isinstance(value, yaml.MappingStartEvent):
            _parameters(events, f"{name}.", into)
        elif isinstance(value, yaml.SequenceStartEvent):
            into[name] = _sequence(events, name)
        else:
            into[name] = value_of(value.value, bool(value.style in ("'", '"')), name)


def _sequence(events: Any, name: str) -> list[Any]:
    items: list[Any] = []
    for event in events:
        if isinstance(event, yaml.SequenceEndEvent):
            if not items:
                raise RclError(f"{name}: a list without a type")
            return items
        if not isinstance(event, yaml.ScalarEvent):
            raise RclError(f"{name}: nested list or mapping in a list")
        items.append(value_of(event.value, event.style in ("'", '"'), name))
        if type(items[-1]) is not type(items[0]):
            raise RclError(f"{name}: sequence should be of same type")
    raise RclError("unexpected end")


def _scalar_text(event: Any) -> str:
    if not isinstance(event, yaml.ScalarEvent):
        raise RclError("only scalars can be keys")
    if not event.value:
        raise RclError("empty key")
    return str(event.value)


def value_of(text: str, is_quoted: bool, name: str = "") -> Any:
    """Return the value that rcl reads from a scalar."""
    if is_quoted:
        return text
    if not text:
        raise RclError(f"{name}: no value")
    if text in TRUE or text in FALSE:
        return text in TRUE
    if INTEGER.fullmatch(text):
        digits = text.strip()
        sign = -1 if digits.startswith("-") else 1
        body = digits.lstrip("+-")
        base = 16 if body.lower().startswith("0x") else 8 if body.startswith("0") else 10
        try:
            number = sign * int(body, base)
        except ValueError:
            pass  # `09`: strtol stops at the 9; strtod reads it
        else:
            if -(1 << 63) <= number < (1 << 63):
                return number
    if NAN_INF.fullmatch(text):
        return float(text.replace(".", ""))
    if DECIMAL.fullmatch(text):
        number_ = float(text)
        if number_ and abs(number_) < 2.2250738585072014e-308:
            return text  # ERANGE
        return number_
    if HEX_REAL.fullmatch(text):
        return float.fromhex(text)
    return text
