"""Writes the text of a robot.yaml with comments that name the source of each module."""

from __future__ import annotations

import json
import math
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.model import Vec3
from thorvaldc.model.spatial import clean

Value = bool | int | float | str | list["Value"] | dict[str, "Value"]

ROOT_MODULE = "frame"  # name of the module that carries all other modules

# Texts that need no quotes in YAML.
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./]*( [A-Za-z0-9_./^]+)*")
_WORDS = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")
_WIDTH = 96  # columns
# Letters that Unicode does not decompose into a base letter and an accent.
_LETTERS = str.maketrans(
    {"ø": "o", "æ": "ae", "œ": "oe", "ß": "ss", "đ": "d", "ð": "d", "ł": "l", "þ": "th"}
)


class Mount(NamedTuple):
    """The place where a module is mounted: ``xyz`` (m) and ``rpy`` (rad) in the parent's frame."""

    xyz: Vec3
    rpy: Vec3 = (0.0, 0.0, 0.0)
    parent: str = ROOT_MODULE


@dataclass
class Module:
    """A module instance of a robot.yaml.

    ``comments`` contains the comment lines above the module in the file.
    """

    name: str
    type: str
    mount: Mount | None = None
    params: dict[str, Value] = field(default_factory=dict)
    can: int | None = None
    channels: dict[str, Value] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)


@dataclass
class Robot:
    """Content of a robot.yaml, in the order of the file."""

    name: str
    comments: list[str] = field(default_factory=list)
    namespace: str = ""
    base_calculator: str = "general"
    library: list[Value] = field(default_factory=list)
    driver: dict[str, Value] = field(default_factory=dict)
    defaults: dict[str, Value] = field(default_factory=dict)
    modules: list[Module] = field(default_factory=list)


def render(robot: Robot) -> str:
    """Returns the text of the robot.yaml of a robot."""
    lines = [*_comments(robot.comments, ""), "thorvaldc: 1", f"name: {robot.name}"]
    if robot.namespace:
        lines.append(f"namespace: {robot.namespace}")
    if robot.library:
        lines.append(f"library: {flow(robot.library)}")
    lines.append(f"base_calculator: {robot.base_calculator}")
    if robot.driver:
        lines.append(f"driver: {flow(robot.driver)}")
    if robot.defaults:
        lines += ["defaults:", "  # equal for all drives of the original file", "  drive:"]
        lines += _entries(robot.defaults, "    ")
    lines.append("modules:")
    for module in robot.modules:
        lines += _comments(module.comments, "  ")
        entry: dict[str, Value] = {"type": module.type}
        if module.mount is not None:
            mount: dict[str, Value] = {"parent": module.mount.parent, "xyz": [*module.mount.xyz]}
            if any(module.mount.rpy):
                mount["rpy"] = [angle(value) for value in module.mount.rpy]
            entry["mount"] = mount
        if module.can is not None:
            entry["can"] = module.can
        if module.params:
            entry["params"] = dict(module.params)
        if module.channels:
            entry["channels"] = module.channels
        short = f"  {module.name}: {flow(entry)}"
        if len(short) <= _WIDTH:
            lines.append(short)
        else:
            lines.append(f"  {module.name}:")
            lines += _entries(entry, "    ")
    return "\n".join(lines) + "\n"


def _comments(comments: Iterable[str], indent: str) -> list[str]:
    return [f"{indent}# {' '.join(comment.split())}".rstrip() for comment in comments]


def _entries(values: dict[str, Value], indent: str) -> list[str]:
    lines: list[str] = []
    for key, value in values.items():
        line = f"{indent}{key}: {flow(value)}"
        if len(line) > _WIDTH and isinstance(value, dict):
            lines.append(f"{indent}{key}:")
            lines += _entries(value, indent + "  ")
        else:
            lines.append(line)
    return lines


def flow(value: Value) -> str:
    """Returns the YAML text of a value on one line (flow style)."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        value = clean(value)
        return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list):
        return f"[{', '.join(flow(v) for v in value)}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {flow(v)}" for k, v in value.items()) + "}"
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    if re.fullmatch(r"-?[0-9.]+ [a-z/^0-9]+", value):
        return value  # a quantity
    return json.dumps(value, ensure_ascii=False)


def angle(radians: float) -> Value:
    """Converts an angle in radians to a value for robot.yaml.

    The result is a text such as ``90 deg`` if the angle is a whole number of degrees.  If the angle
    is not a whole number of degrees, the result is the number of radians.
    """
    degrees = math.degrees(radians)
    return f"{round(degrees)} deg" if degrees and abs(degrees - round(degrees)) < 1e-9 else radians


class Names:
    """Converts names of an original configuration file to unique module names."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = dict.fromkeys(taken)

    def make(self, text: str, fallback: str) -> str:
        """Returns a unique module name for a name of the original file.

        If the module name is already used, a number such as ``_2`` is added.  ``fallback`` is used
        if ``text`` contains no letter.
        """
        name = as_id(text) or fallback
        unique, count = name, 2
        while unique in self._taken:
            unique, count = f"{name}_{count}", count + 1
        self._taken[unique] = None
        return unique


def as_id(text: str) -> str:
    """Converts a text to a module name, which has the form ``[a-z][a-z0-9_]*``.

    Returns an empty text if ``text`` contains no letter.

    Letters are converted to lower case without accents.  Other characters are replaced by
    underscores.
    """
    text = text.lower().translate(_LETTERS)
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "_", plain).strip("_").lstrip("0123456789_")
