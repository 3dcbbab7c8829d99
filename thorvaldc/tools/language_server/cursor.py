"""The place of the cursor in a YAML document that is half typed.

A YAML parser refuses a document such as ``fl: {type: ass``.  ``cursor_at`` reads only the text
before the cursor: the indentation of block mappings and the brackets of flow mappings say in which
mapping and at which key the cursor is.  Text that is no valid YAML is skipped.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal

from thorvaldc.compiler.source.node import KeyPath
from thorvaldc.tools.language_server import open_document

_KEY = re.compile(
    r"""(?:"((?:[^"\\]|\\.)*)"|'((?:[^']|'')*)'|([^\s\-?#{}\[\],&*!|>'"%@`:][^#\n]*?|-[^\s#:]+))"""
    r"""[ \t]*:(?=[ \t]|$)"""
)
_BLOCK_SCALAR = re.compile(r"[|>][-+0-9]*[ \t]*(?:#.*)?$")
_CLOSING = {"{": "}", "[": "]"}


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


@dataclass
class _Frame:
    """A mapping or list that is open: at an indentation, or in brackets (``bracket``)."""

    indent: int
    key: str | int | None
    bracket: str = ""


@dataclass
class _Scanner:
    text: str
    offset: int
    frames: list[_Frame] = field(default_factory=list)
    scalar_indent: int | None = None  # of the key of a block scalar
    # The token that is open at the end of the text.
    token_start: int = 0
    token_quote: str = ""
    slot: Literal["key", "value", "either"] = "key"

    def run(self) -> Cursor:
        for line in open_document.LINE.finditer(self.text, 0, self.offset):
            if line.start() == line.end() and line.start() < self.offset:
                continue
            self._line(line.start(), line.end())
            if line.end() == self.offset and not line[0].endswith(("\n", "\r")):
                break
        prefix = self.text[self.token_start : self.offset]
        path = [frame.key for frame in self.frames if frame.key is not None]
        if self.slot == "key" and self.frames and self.frames[-1].key is not None:
            path.pop()
        closing = "".join(_CLOSING[f.bracket] for f in reversed(self.frames) if f.bracket)
        return Cursor(tuple(path), self.slot, prefix, self.token_start, self.token_quote, closing)

    # -- block style ------------------------------------------------------------------

    def _line(self, start: int, end: int) -> None:
        line = self.text[start:end].rstrip("\r\n")
        is_last = end >= self.offset and not self.text[start:end].endswith(("\r", "\n"))
        content = line.lstrip(" ")
        indent = len(line) - len(content)
        if self.scalar_indent is not None:
            if not content or indent > self.scalar_indent:
                self._set_token(start + len(line), "value")
                return
            self.scalar_indent = None
        if self.frames and self.frames[-1].bracket:
            outer = max((f.indent for f in self.frames if not f.bracket), default=-1)
            ends_early = indent <= outer and _KEY.match(content)
            if not ends_early or content[:1] in ("}", "]"):
                self._flow(start, start + len(line))
                return
            while self.frames and self.frames[-1].bracket:
                self.frames.pop()
        if not content and not is_last:
            return
        if content.startswith("#"):
            if is_last:
                self._set_token(start + len(line), "value")
            return
        self._block_content(start, indent, line)

    def _block_content(self, start: int, column: int, line: str) -> None:
        while (item := re.match(r"-(?:[ \t]+|$)", line[column:])) is not None:
            self._close(column, keep_list=True)
            top = self.frames[-1] if self.frames else None
            if top is not None and top.indent == column and isinstance(top.key, int):
                top.key += 1
            else:
                self.frames.append(_Frame(column, 0))
            column += item.end()
            self._set_token(start + column, "either")
        key = _KEY.match(line, column)
        if key is None:
            if column >= len(line) or "-" not in line[:column]:
                self._close(column, keep_list="-" in line[:column])
            self._open_token(start + column, line[column:])
            return
        self._close(column)
        name = next(group for group in key.groups() if group is not None)
        top = self.frames[-1] if self.frames else None
        if top is not None and top.indent == column and not isinstance(top.key, int):
            top.key = name
        else:
            self.frames.append(_Frame(column, name))
        rest = line[key.end() :]
        value = rest.lstrip(" \t")
        value_start = start + len(line) - len(value)
        self._set_token(value_start, "value")
        if not rest and value_start == self.offset:
            self._set_token(self.offset, "value")
        if _BLOCK_SCALAR.match(value):
            self.scalar_indent = column
        elif value[:1] in _CLOSING:
            self._flow(value_start, start + len(line))
        elif value[:1] in ("'", '"'):
            self._set_token(value_start + 1, "value", value[0])

    def _close(self, column: int, *, keep_list: bool = False) -> None:
        """Closes the mappings and lists that are indented more than ``column``.

        - ``keep_list``: whether a list at the column stays open.
        """
        while self.frames and self.frames[-1].indent > column:
            self.frames.pop()
        top = self.frames[-1] if self.frames else None
        if top is not None and top.indent == column and isinstance(top.key, int) and not keep_list:
            self.frames.pop()

    def _open_token(self, start: int, token: str) -> None:
        """Sets the token of a line without a colon: a key that is being typed, or a value."""
        column = self._column(start)
        top = self.frames[-1] if self.frames else None
        slot: Literal["key", "either"] = "key"
        if top is not None and (top.indent < column or isinstance(top.key, int)):
            slot = "either"
        if token[:1] in _CLOSING:
            self.slot = "value"
            self._flow(start, start + len(token))
            return
        quote = token[:1] if token[:1] in ("'", '"') else ""
        self._set_token(start + len(quote), slot, quote)

    def _column(self, offset: int) -> int:
        return offset - max(self.text.rfind("\n", 0, offset), self.text.rfind("\r", 0, offset)) - 1

    def _set_token(
        self, start: int, slot: Literal["key", "value", "either"], quote: str = ""
    ) -> None:
        self.token_start, self.slot, self.token_quote = min(start, self.offset), slot, quote

    # -- flow style -------------------------------------------------------------------

    def _flow(self, start: int, end: int) -> None:
        """Reads brackets, quotes and commas in a part of a line."""
        if self.frames and self.frames[-1].bracket and not self.token_quote:
            # The text of a flow mapping goes on in a new line.
            self._skip_space(start)
        index = start
        quote = self.token_quote if self.frames and self.frames[-1].bracket else ""
        while index < end:
            character = self.text[index]
            if quote:
                if character == "\\" and quote == '"':
                    index += 1
                elif character == quote:
                    quote = self.token_quote = ""
            elif character in _CLOSING:
                self.frames.append(_Frame(-1, 0 if character == "[" else None, character))
                self._skip_space(index + 1)
            elif character in "}]":
                self._end_flow(index)
                if not self.frames or not self.frames[-1].bracket:
                    return
            elif character == ",":
                top = self.frames[-1]
                top.key = top.key + 1 if isinstance(top.key, int) else None
                self._skip_space(index + 1)
            elif character == "#" and (index == start or self.text[index - 1] in " \t"):
                return
            elif character == ":" and self._ends_key(index, end):
                self._flow_key(index)
            elif character in "'\"" and self.text[self.token_start : index].strip() == "":
                quote = character
                self._set_token(index + 1, self.slot, quote)
            index += 1

    def _ends_key(self, index: int, end: int) -> bool:
        if self.frames[-1].bracket != "{" or self.frames[-1].key is not None:
            return False
        after_quote = self.text[index - 1] in "'\""
        return after_quote or index + 1 >= end or self.text[index + 1] in " \t,{}[]"

    def _flow_key(self, index: int) -> None:
        name = self.text[self.token_start : index].strip()
        self.frames[-1].key = name.strip("'\"")
        self._skip_space(index + 1)

    def _skip_space(self, index: int) -> None:
        while index < self.offset and self.text[index] in " \t":
            index += 1
        top = self.frames[-1]
        is_key = top.bracket == "{" and top.key is None
        self._set_token(index, "key" if is_key else "value" if top.bracket == "{" else "either")

    def _end_flow(self, index: int) -> None:
        while self.frames and self.frames[-1].bracket:
            if _CLOSING[self.frames.pop().bracket] == self.text[index]:
                break
        self._set_token(index + 1, "value")


def cursor_at(text: str, offset: int) -> Cursor:
    """Returns the place of the cursor at an offset of a text."""
    return _Scanner(text, offset).run()
