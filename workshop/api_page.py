"""Writes docs/api.md, the reference of the Python API, from the docstrings.

    python workshop/api_page.py

The page reads well in a plain checkout and on the site.  A test compares it with the docstrings.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import re
from pathlib import Path
from types import FunctionType
from typing import Any

import thorvaldc
from thorvaldc import model

PAGE = Path(__file__).resolve().parents[1] / "docs/api.md"
SECTIONS = (
    ("Read and compile files", ("load", "load_fleet", "compile", "Compilation", "CompileError")),
    ("Diagnostics", ("Report", "Diagnostic", "Severity", "Span", "DiagnosticError")),
    ("Generate files", ("emit",)),
    (
        "Simulate",
        (
            "Episode",
            "Sample",
            "JointCommands",
            "Simulation",
            "SimulationResult",
            "RobotResult",
            "SensorSettings",
            "Scenario",
        ),
    ),
    ("Drive", ("BaseDriver", "DriverState", "SimBase", "Twist", "Pose2")),
    ("The model", ("Robot", "Fleet")),
)
INTERNAL = frozenset(["of", "located", "complete", "used_by", "excluding_spans_of", "has_error_in"])
"""Methods for the stages of the compiler."""
INTRODUCTION = """# Python API: reference

<!-- Generated from the docstrings by workshop/api_page.py. -->

`import thorvaldc` has these names. [The Python API](python.md) shows how to use them.

All values are in SI units: m, kg, s, rad, N, N m. The frame `base_link` lies on the ground below
the robot: x forward, y to the left, z up. Quaternions are (w, x, y, z).
"""
MODEL = """## Classes of the model

`from thorvaldc.model import Link` and so on. `load` returns them as parts of a `Robot`. They are
immutable; two of them are equal if all fields are equal. A field `span` is the position in the
YAML file.
"""
WIDTH = 88


def page() -> str:
    """Returns the text of docs/api.md."""
    parts = [INTRODUCTION]
    for title, names in SECTIONS:
        parts.append(f"## {title}\n")
        parts += [entry(name, getattr(thorvaldc, name)) for name in names]
    parts.append(MODEL)
    for name in sorted(set(model.__all__) - set(thorvaldc.__all__)):
        value = getattr(model, name)
        if isinstance(value, type):
            parts.append(entry(name, value, with_methods=False))
    return re.sub(r"\n{3,}", "\n\n", "\n".join(part.rstrip() + "\n" for part in parts))


def entry(name: str, value: Any, with_methods: bool = True) -> str:
    """Returns the section of a function or class."""
    if isinstance(value, FunctionType):
        return f"### {name}\n\n{signature(f'thorvaldc.{name}', value)}\n\n{in_markdown(value)}"
    parts = [f"### {name}\n"]
    fields = fields_of(value)
    if "__init__" in vars(value) and not fields and not issubclass(value, Exception | enum.Enum):
        parts.append(signature(f"thorvaldc.{name}", value.__init__) + "\n")
    text = in_markdown(value)
    if fields:
        text, descriptions = without_fields(text, fields)
        rows = [
            f"| `{field}` | {code(hint)} | {descriptions.get(field, '')} |"
            for field, hint in fields
        ]
        table = "\n".join(["| field | type | |", "| --- | --- | --- |", *rows])
        text = f"{text.rstrip()}\n\n{table}\n"
    parts.append(text)
    if issubclass(value, enum.Enum):
        parts.append(", ".join(f"`{member}`" for member in value.__members__) + "\n")
    elif "__init__" in vars(value) and not fields and value.__init__.__doc__:
        parts.append(in_markdown(value.__init__) + "\n")
    if with_methods:
        parts += [member_entry(name, n, m) for n, m in vars(value).items() if is_public(n, m)]
    return "\n".join(parts)


def is_public(name: str, member: Any) -> bool:
    kinds = FunctionType | property | classmethod | staticmethod
    return not name.startswith("_") and name not in INTERNAL and isinstance(member, kinds)


def member_entry(owner: str, name: str, member: Any) -> str:
    if isinstance(member, property):
        hint = member.fget.__annotations__.get("return", "") if member.fget else ""
        return f"`{owner}.{name}`: {code(hint)}\n\n{in_markdown(member)}\n"
    function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
    return f"{signature(f'{owner}.{name}', function)}\n\n{in_markdown(function)}\n"


def signature(name: str, function: Any) -> str:
    """Returns the call of a function as a code block, without ``self``."""
    text = inspect.signature(function)
    arguments: list[str] = []
    for parameter in text.parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in arguments:
            arguments.append("*")
        stars = "**" if parameter.kind is parameter.VAR_KEYWORD else ""
        default = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
        arguments.append(f"{stars}{parameter.name}: {parameter.annotation}{default}")
    result = (
        "" if text.return_annotation in ("None", text.empty) else f" -> {text.return_annotation}"
    )
    line = f"{name}({', '.join(arguments)}){result}"
    if len(line) > WIDTH:
        line = f"{name}(\n" + "".join(f"    {argument},\n" for argument in arguments) + f"){result}"
    return f"```text\n{line}\n```"


def fields_of(value: type) -> list[tuple[str, str]]:
    """Names and types of the fields of a dataclass or named tuple."""
    if dataclasses.is_dataclass(value):
        return [(field.name, str(field.type)) for field in dataclasses.fields(value)]
    names = getattr(value, "_fields", ())
    return [(name, hint_text(value.__annotations__[name])) for name in names]


def hint_text(hint: Any) -> str:
    return getattr(hint, "__forward_arg__", None) or getattr(hint, "__name__", str(hint))


def without_fields(text: str, fields: list[tuple[str, str]]) -> tuple[str, dict[str, str]]:
    """Takes the list items that describe fields out of a text: the text, and item by field."""
    known = {name for name, _ in fields}
    descriptions = {"span": "position in the YAML file."}

    def taken(match: re.Match[str]) -> str:
        names = re.findall(r"`(\w+)`", match["names"])
        if not set(names) <= known:
            return match[0]
        for name in names:
            descriptions[name] = " ".join(match["text"].split()).replace("|", r"\|")
        return ""

    item = r"^- (?P<names>`\w+`(?:, `\w+`)*): (?P<text>.*(?:\n  .*)*)\n?"
    return re.sub(r"\n{3,}", "\n\n", re.sub(item, taken, text, flags=re.M)), descriptions


def in_markdown(value: Any) -> str:
    """Returns a docstring as Markdown: sections as lists, examples as code."""
    text = inspect.getdoc(value) or ""
    text = re.sub(r"``([^`]+)``", r"`\1`", text)
    text = re.sub(r"^\* ", "- ", text, flags=re.M)
    text = re.sub(r"\.  (?=\S)", ". ", text)
    text = re.sub(r"^(Parameters|Attributes)\n-+\n((?:.+\n?)*)", listed, text, flags=re.M)
    text = re.sub(
        r"((?:^(?:>>> |\.\.\. ).*\n?(?:^(?!>>> |\.\.\. )\S.*\n?)*)+)", console, text, flags=re.M
    )
    return text.rstrip() + "\n"


def listed(match: re.Match[str]) -> str:
    """``name : text`` below a heading becomes ``- `name`: text``."""
    items = re.sub(r"^(\w+) : ", r"- `\1`: ", match[2], flags=re.M)
    items = re.sub(r"^    (?=\S)", "  ", items, flags=re.M)
    title = "" if match[1] == "Attributes" else f"{match[1]}:\n\n"
    return title + items


def console(match: re.Match[str]) -> str:
    return f"```pycon\n{match[1].rstrip()}\n```\n"


def code(hint: str) -> str:
    return f"`{hint}`".replace("|", r"\|") if hint else ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
