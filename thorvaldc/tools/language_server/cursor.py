"""The place of the cursor in a YAML document that is half typed.

The YAML parser itself says where the cursor is: ``cursor_at`` writes a mark there, closes the
brackets around it, and looks for the mark in the tree of the text up to the cursor.  A word without
a colon can be a value or the begin of a key, so both are tried.  Lines that are no YAML are left
out, as in ``tree_of``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import yaml

from thorvaldc.compiler.source.node import KeyPath, Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report
from thorvaldc.tools.language_server import open_document

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_BRACKETS = {yaml.FlowMappingStartToken: "{", yaml.FlowSequenceStartToken: "["}
_CLOSING = {yaml.FlowMappingStartToken: "}", yaml.FlowSequenceStartToken: "]"}
_SECTION = re.compile(r"^[^\s#}\]-]", re.MULTILINE)
_KEY = re.compile(r" *[^\s{}\[\],#]+[ \t]*:(?=[ \t]|$)")


@dataclass(frozen=True)
class Cursor:
    """The place of the cursor in a document.

    Attributes
    ----------
    path : path of the mapping that receives a key, or of the value.
    slot : ``key`` in a mapping, ``value`` after a colon.  ``either`` at the start of an element of
        a list or of an indented line, which can become a mapping or a value.
    prefix : text before the cursor that belongs to the key or value.
    start : offset of ``prefix`` in the text.
    quote : the quote that is open, or an empty text.
    closing : brackets that close the flow mappings and lists around the cursor.
    """

    path: KeyPath
    slot: Literal["key", "value", "either"]
    prefix: str
    start: int
    quote: str = ""
    closing: str = ""

    @property
    def in_flow(self) -> bool:
        """Whether the cursor is inside of braces or brackets."""
        return bool(self.closing)


def cursor_at(text: str, offset: int) -> Cursor:
    """Returns the place of the cursor at an offset of a text."""
    text = text[:offset].encode("utf-8", "replace").decode()
    line_start = max(text.rfind("\n"), text.rfind("\r")) + 1
    line = text[line_start:]
    head, outer = _continued(text[:line_start], line)
    tokens, quote = _scan(outer + line)
    brackets = _open(tokens)
    closing = "".join(_CLOSING[type(token)] for token in reversed(brackets))
    start = len(outer + line)
    if tokens and isinstance(tokens[-1], yaml.ScalarToken):
        last = tokens[-1]
        if quote or not (outer + line)[last.end_mark.index :].strip():
            start = last.start_mark.index + len(quote)
            tokens.pop()
    start = max(start - len(outer), 0)
    prefix, stem = line[start:], head + line[:start]
    place = prefix, line_start + start, quote, closing
    is_value = bool(tokens) and isinstance(tokens[-1], yaml.ValueToken)
    if not quote and stem.endswith((":", "-")):
        stem += " "
    mark = next(sign for sign in map(chr, range(0xE000, 0xF900)) if sign not in text)
    # In a block mapping, a word without a colon can be a value or the begin of a key.
    ends = [""] if is_value or brackets else ["", ": "]
    for tree in _trees(stem + mark + quote, ends, closing):
        for path, node in tree.walk():
            if path and mark in str(path[-1]):
                return Cursor(path[:-1], "key", *place)
            if isinstance(node.value, str) and mark in node.value:
                return Cursor(path, "value" if is_value else "either" if path else "key", *place)
    # After a closed bracket, or at an indentation of no mapping: nothing fits here.
    return Cursor((), "value", *place)


def _trees(text: str, ends: list[str], closing: str) -> Iterator[Node]:
    """Yields the trees of a text with each of the ends, first those of valid documents."""
    for end in ends:
        tree = read_text((text + end + closing).encode(), "", Report())
        if tree is not None:
            yield tree
    for end in reversed(ends):
        repaired = open_document.tree_of(open_document.SourceText(text + end + closing), "")
        if repaired is not None:
            yield repaired


def _continued(head: str, line: str) -> tuple[str, str]:
    """Returns the text before a line, and the brackets in it that the line continues.

    A bracket is forgotten, and its line left out, where a less indented line begins with a key.
    """
    sections = list(_SECTION.finditer(head))
    section = sections[-1].start() if sections else 0
    lines = head[section:].splitlines(keepends=True)
    brackets = ""
    for token in _open(_scan(head[section:])[0]):
        row = token.start_mark.line
        if _KEY.match(line) and _indent(line) <= _indent(lines[row]):
            lines[row] = "\n"
        else:
            brackets += _BRACKETS[type(token)]
    return head[:section] + "".join(lines), brackets


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))


def _open(tokens: list[Any]) -> list[Any]:
    """Returns the brackets that are open after the tokens."""
    brackets: list[Any] = []
    for token in tokens:
        if type(token) in _BRACKETS:
            brackets.append(token)
        elif isinstance(token, yaml.FlowMappingEndToken | yaml.FlowSequenceEndToken) and brackets:
            brackets.pop()
    return brackets


def _scan(text: str) -> tuple[list[Any], str]:
    """Returns the tokens of a text up to an error, and the quote that is open at its end."""
    quote = ""
    while True:
        try:
            tokens = list(yaml.scan(text + quote, Loader=_LOADER))
        except yaml.MarkedYAMLError as error:
            begin, end = error.context_mark, error.problem_mark
            if begin and not quote and error.context == "while scanning a quoted scalar":
                quote = text[begin.index]
            elif end and end.index < len(text):
                text, quote = text[: end.index], ""
            else:
                return [], ""
        except yaml.YAMLError:
            return [], ""
        else:
            ends = yaml.StreamStartToken | yaml.StreamEndToken | yaml.BlockEndToken
            return [token for token in tokens if not isinstance(token, ends)], quote
