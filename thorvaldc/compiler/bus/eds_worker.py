"""Reads an EDS or DCF file (CiA 306), as the service of a limited worker process.

The data of a request is the file.  The answer has ``info`` (the section of the device, with keys in
lower case), ``node_id`` (of a DCF, or ``None``) and ``objects``: by ``"index:subindex"`` in decimal
the name, data type, access, default value, limits, whether a PDO can contain it, and the line of
its section.  A number with ``$NODEID`` is the pair (number, 1), others are (number, 0).  Instead,
the answer has ``error`` and ``line`` if the file has no such content.
"""

from __future__ import annotations

import configparser
import re
from typing import Any

_SECTION = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2})|(name|value))?", re.IGNORECASE)
_MOST_ENTRIES = 254
Number = tuple[int, int]


class _Broken(Exception):
    """The file is no EDS; the arguments are the reason and the line."""


def answer(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Reads the file of a request, see ``worker_protocol``."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")
    parser = configparser.RawConfigParser(
        delimiters=("=",),
        comment_prefixes=(";", "#"),
        inline_comment_prefixes=(";",),
        default_section="\0",
        empty_lines_in_values=False,
    )
    try:
        parser.read_string(text)
        return _content(parser, _lines(text)), b""
    except _Broken as error:
        reason, line = error.args
    except configparser.ParsingError as error:  # some have the line, some a list of them
        reason, line = "a line is neither `[section]` nor `key=value`", _line_of(error)
    except (configparser.DuplicateSectionError, configparser.DuplicateOptionError) as error:
        reason, line = str(error).partition("]: ")[2], error.lineno or 1
    return {"error": reason, "line": line}, b""


def _line_of(error: configparser.ParsingError) -> int:
    errors = getattr(error, "errors", [])
    return int(errors[0][0] if errors else getattr(error, "lineno", 1))


def _lines(text: str) -> dict[str, int]:
    """Returns the line of each section, by its name in lower case."""
    lines: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if section := re.match(r"\[(.+?)\]", line):
            lines.setdefault(section[1].lower(), number)
    return lines


def _content(parser: configparser.RawConfigParser, lines: dict[str, int]) -> dict[str, Any]:
    sections = {name.lower(): dict(parser[name]) for name in parser.sections()}
    objects: dict[str, dict[str, Any]] = {}
    for name, keys in sections.items():
        match = _SECTION.fullmatch(name)
        if match is None or match[3]:
            continue
        index, line = int(match[1], 16), lines.get(name, 1)
        if match[2] is not None:
            parent = sections.get(match[1], {}).get("parametername")
            objects[f"{index}:{int(match[2], 16)}"] = _object(keys, line, parent)
        elif compact := _number(keys.get("compactsubobj"), line):
            objects |= _compact(index, keys, compact[0], sections, line)
        elif not keys.get("subnumber"):
            objects[f"{index}:0"] = _object(keys, line, None)
    if not any(key.startswith(f"{0x1000}:") for key in objects):
        raise _Broken(
            "it has no section [1000], the device type, which every CANopen device has", 1
        )
    commissioning = sections.get("devicecomissioning", sections.get("devicecommissioning", {}))
    node_id = _number(commissioning.get("nodeid"), lines.get("devicecomissioning", 1))
    info = {key: value or "" for key, value in sections.get("deviceinfo", {}).items()}
    return {"info": info, "node_id": node_id[0] if node_id else None, "objects": objects}


def _compact(
    index: int, keys: dict[str, str], count: int, sections: dict[str, dict[str, str]], line: int
) -> dict[str, dict[str, Any]]:
    """Returns the objects of an array that one section describes (``CompactSubObj``)."""
    if not 0 < count <= _MOST_ENTRIES:
        raise _Broken(f"CompactSubObj is {count}; an array has 1 to {_MOST_ENTRIES} entries", line)
    values, names = (sections.get(f"{index:04x}{part}", {}) for part in ("value", "name"))
    objects = {f"{index}:0": _object({"datatype": "5", "defaultvalue": str(count)}, line, None)}
    for number in range(1, count + 1):
        own = {"parametername": names.get(str(number)) or keys.get("parametername", "")}
        if str(number) in values:
            own["parametervalue"] = values[str(number)]
        objects[f"{index}:{number}"] = _object(keys | own, line, keys.get("parametername"))
    return objects


def _object(keys: dict[str, str], line: int, parent: str | None) -> dict[str, Any]:
    kind = _number(keys.get("datatype"), line)
    mapping = _number(keys.get("pdomapping"), line)
    value = keys.get("parametervalue") or keys.get("defaultvalue")
    # Texts and numbers with a point are values too, of which a module needs none.
    is_integer = kind is not None and kind[0] in (*range(1, 8), 0x10, *range(0x12, 0x1C))
    return {
        "name": keys.get("parametername") or "",
        "parent": parent or "",
        "type": kind[0] if kind else 0,
        "access": (keys.get("accesstype") or "").lower(),
        "value": _number(value, line) if is_integer else None,
        "low": _number(keys.get("lowlimit"), line) if is_integer else None,
        "high": _number(keys.get("highlimit"), line) if is_integer else None,
        "mappable": bool(mapping and mapping[0]),
        "line": line,
    }


def _number(text: str | None, line: int) -> Number | None:
    """Returns a number such as ``0x1F``, ``017`` (octal), ``31`` or ``$NODEID+0x180``."""
    text = "".join((text or "").lower().split())
    if not text:
        return None
    parts = text.split("+")
    nodes = parts.count("$nodeid")
    numbers = [part for part in parts if part != "$nodeid"]
    if nodes <= 1 and len(numbers) <= 1 and all(map(_is_number, numbers)):
        return (_integer(numbers[0]) if numbers else 0), nodes
    raise _Broken(f"`{text[:40]}` is not a whole number", line)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"-?(0x[0-9a-f]{1,16}|\d{1,20})", text) is not None


def _integer(text: str) -> int:
    sign, digits = (-1, text[1:]) if text.startswith("-") else (1, text)
    if digits.startswith("0x"):
        return sign * int(digits, 16)
    is_octal = digits.startswith("0") and not set(digits) & {"8", "9"}
    return sign * int(digits, 8 if is_octal else 10)
