"""A small formatter of white space that never changes the values or the comments of a document.

It removes spaces at the end of lines and empty lines at the end of the document, and it adds a
missing space after a comma in brackets and the missing line break at the end.  It keeps comments,
quotes, order, indentation and aligned columns.  A document whose values would change, or that is
not valid YAML, is left as it is.
"""

from __future__ import annotations

import re

from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report

_LINE = re.compile(r"([^\r\n]*)(\r\n|\r|\n|\Z)")
_BLOCK_SCALAR = re.compile(r"(?:^|[:\-])[ \t]+[|>][-+0-9]*[ \t]*(?:#.*)?$|^[|>]")
_FLOW = re.compile(r"(?:^|: |- )[ \t]*(?=[{\[])")
_COMMA = re.compile(r",(?=[^\s,}\]])")
MAX_EMPTY_LINES = 2


def formatted(text: str) -> str:
    """Returns the formatted text, or the same text if it has YAML errors."""
    before = _values(text)
    if before is None:
        return text
    result = _formatted_lines(text)
    return result if _values(result) == before else text


def _values(text: str) -> object:
    report = Report()
    node = read_text(text.encode("utf-8", "surrogatepass"), "", report)
    return None if node is None or report.has_errors else (node.plain(), _quotes(node))


def _quotes(node: object) -> object:
    value = getattr(node, "value", None)
    if isinstance(value, dict):
        return [_quotes(child) for child in value.values()]
    if isinstance(value, tuple):
        return [_quotes(child) for child in value]
    return getattr(node, "quoted", False)


def _formatted_lines(text: str) -> str:
    line_break = "\r\n" if "\r\n" in text else "\n"
    lines: list[tuple[str, str]] = []
    scalar_indent: int | None = None
    empty = 0
    for match in _LINE.finditer(text):
        line, ending = match[1], match[2]
        content = line.strip(" \t")
        indent = len(line) - len(line.lstrip(" "))
        if scalar_indent is not None and content and indent <= scalar_indent:
            scalar_indent = None
        if scalar_indent is None:
            line = _formatted_line(line)
            empty = 0 if content else empty + 1
            if empty > MAX_EMPTY_LINES:
                continue
            if content and not content.startswith("#") and _BLOCK_SCALAR.search(content):
                scalar_indent = indent
        lines.append((line, ending))
    while lines and not lines[-1][0].strip():
        lines.pop()
    if not lines:
        return text
    last, ending = lines[-1]
    return "".join(line + end for line, end in lines[:-1]) + last + (ending or line_break)


def _formatted_line(line: str) -> str:
    stripped = line.rstrip(" \t")
    flow = _FLOW.search(stripped)
    if flow is None or {"#", "'", '"'} & set(stripped):
        return stripped  # a comma in a comment or in quotes has no space of its own
    return stripped[: flow.end()] + _COMMA.sub(", ", stripped[flow.end() :])
