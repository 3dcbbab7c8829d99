"""YAML values with their lines and columns in a YAML file (source spans).

Unquoted scalars are converted by the core schema of YAML 1.2.  YAML 1.1 interprets some of them
differently.  For example, it reads ``on`` as true and ``010`` as 8.  YAML 1.2 reads ``on`` as a
text and ``010`` as 10.  The compiler reports an error for each value that both interpret
differently.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from thorvaldc.diagnostics import Proposal, Report, Span

KeyPath = tuple[str | int, ...]
"""Keys of mappings and indices of lists, from the top of a document."""
Value = None | bool | int | float | str | tuple["Node", ...] | dict[str, "Node"]


class Node(NamedTuple):
    """A YAML value with its source span (file, line and column).

    - ``value``: a scalar, a tuple of nodes for a list, or a dict of nodes for a mapping.
    - ``span``: source span of the value.
    - ``key_span``: source span of the key, if the value is an entry of a mapping.
    - ``quoted``: whether the value is in quotes.  In YAML, ``"3"`` is a text and ``3`` is a number.
    """

    value: Value
    span: Span
    key_span: Span | None = None
    quoted: bool = False

    def get(self, key: str) -> Node | None:
        """Returns the value of the key ``key`` in a YAML mapping.

        Returns ``None`` if the YAML mapping has no such key, or if the YAML value is not a mapping.
        """
        value = self.value
        return value.get(key) if isinstance(value, dict) else None

    def children(self) -> Iterable[tuple[str | int, Node]]:
        """Returns the entries of a YAML mapping with their keys, or the elements of a YAML list
        with their indices from 0.  A scalar has none.
        """
        if isinstance(self.value, dict):
            return self.value.items()
        return enumerate(self.value) if isinstance(self.value, tuple) else ()

    def walk(self, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Node]]:
        """Yields this YAML value and all values below it with their paths, in the order of the
        file.
        """
        yield path, self
        for key, child in self.children():
            yield from child.walk((*path, key))

    def plain(self) -> Any:
        """Returns a YAML value as plain Python dicts, lists and scalars, without source spans."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        return self.value

    def places(self) -> Iterator[Span]:
        """Yields the span of a key with its value, and those of values of another file in it."""
        for _, node in self.walk():
            if node is self or node.where.file != self.where.file:
                yield Span(*node.where[:3], node.span.end_line, node.span.end_column)

    @property
    def where(self) -> Span:
        """Source span of the YAML key, or of the YAML value if the value has no key."""
        return self.key_span or self.span


def describe_node(node: Node) -> str:
    """Describes the value of a YAML node for an error message."""
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, bool):
        return f"`{str(node.value).lower()}`"
    text = str(node.value)
    return f"`{text if len(text) <= 60 else text[:57] + '...'}`"


def whole_number_hint(node: Node) -> Proposal | None:
    """Returns the hint for a whole number with a unit, such as ``1024 ppr``, or ``None``."""
    if isinstance(node.value, str) and (match := re.fullmatch(_WITH_UNIT, node.value)):
        return Proposal(f"write `{match[1]}`: this number has no unit", match[1])
    return None


_WITH_UNIT = r"([-+]?[0-9]+) *[A-Za-z]\w*"

# -- unquoted scalars -------------------------------------------------------------

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_HEX_OR_OCTAL = re.compile(r"0x[0-9a-fA-F]+|0o[0-7]+")

_WORDS: dict[str, bool | None] = {
    "": None,
    "~": None,
    "null": None,
    "Null": None,
    "NULL": None,
    "true": True,
    "True": True,
    "TRUE": True,
    "false": False,
    "False": False,
    "FALSE": False,
}
_AMBIGUOUS = {
    form: truth
    for words, truth in ((("on", "yes", "y"), True), (("off", "no", "n"), False))
    for word in words
    for form in (word, word.capitalize(), word.upper())
}


def plain_scalar(text: str, span: Span, report: Report) -> Value:
    """Returns the Python value of an unquoted YAML scalar.

    If the YAML scalar has an error, adds a diagnostic to ``report`` and returns the most likely
    value.
    """
    if text in _WORDS:
        return _WORDS[text]
    if text[0] in "-+.0123456789":
        return _number(text, span, report)
    if text in _AMBIGUOUS:
        truth = _AMBIGUOUS[text]
        report.add(
            "yaml-ambiguous-word",
            f"`{text}` is a truth value for some YAML readers and text for others",
            span,
            hint=_alternatives(
                "write `{}` if that is meant, `{}` for text; a quantity is a number with a unit",
                "true" if truth else "false",
                f'"{text}"',
            ),
        )
        return truth if len(text) > 1 else text
    return text


def _number(text: str, span: Span, report: Report) -> Value:
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        if digits[0] == "0" and len(digits) > 1:
            decimal = digits.lstrip("0") or "0"
            report.add(
                "yaml-leading-zero",
                f"`{text}` starts with 0: octal for some YAML readers, decimal for others",
                span,
                hint=_leading_zero_hint(text, decimal),
            )
            if len(decimal) > 20:
                return 0
            return int(decimal)
        if len(digits) > 20 or not -(2**63) <= int(text) < 2**64:
            return _too_large(text, span, report)
        return int(text)
    if _FLOAT.fullmatch(text):
        value = float(text)
        return value if math.isfinite(value) else _too_large(text, span, report)
    if _HEX_OR_OCTAL.fullmatch(text):
        return int(text, 0) if len(text) <= 18 else _too_large(text, span, report)
    if text.lstrip("+-").lower() in (".inf", ".nan"):
        report.add(
            "yaml-not-finite",
            f"`{text}` is not a finite number",
            span,
            hint="to set no limit, remove the key",
        )
        return 0.0
    return text


def _alternatives(hint: str, *replacements: str) -> Proposal:
    return Proposal(hint.format(*replacements), *replacements)


def _leading_zero_hint(text: str, decimal: str) -> Proposal:
    sign = "-" if text[0] == "-" else ""
    if "8" in decimal or "9" in decimal or sign:
        return _alternatives("write `{}`, or `{}` for text", sign + decimal, f'"{text}"')
    return _alternatives(
        "write `{}`, `{}` for octal, or `{}` for text", decimal, f"0o{decimal}", f'"{text}"'
    )


def _too_large(text: str, span: Span, report: Report) -> Value:
    shown = text if len(text) <= 40 else text[:37] + "..."
    report.add(
        "yaml-number-range",
        f"the number `{shown}` is too large",
        span,
        hint="integers have 64 bits; other numbers are at most 1.8e308",
    )
    return 0


def is_plain_text(text: str) -> bool:
    """Returns whether every YAML reader reads an unquoted scalar as text."""
    if text in _WORDS or text in _AMBIGUOUS:
        return False
    if _INTEGER.fullmatch(text) or _FLOAT.fullmatch(text):
        return False
    return not text.startswith("0") or " " in text  # `0x1f`, `010` and `0:30`, but not `0.9 m`


def key_kind(text: str) -> str | None:
    """Returns the kind of an unquoted YAML mapping key, or ``None`` if the key is a text.

    The YAML mapping keys ``on`` and ``y`` are texts, because YAML 1.2 reads them as texts.
    """
    if text in _WORDS:
        return "null" if _WORDS[text] is None else "a truth value"
    if text[0] in "-+.0123456789" and (
        _INTEGER.fullmatch(text) or _FLOAT.fullmatch(text) or _HEX_OR_OCTAL.fullmatch(text)
    ):
        return "a number"
    return None


# -- text of a YAML document, for hints that propose a change ----------------------

# Texts that need no quotes in a YAML flow mapping, such as `frame.front_left`, `650 mm` or `42:1`.
_NEEDS_NO_QUOTES = (
    r"(?ai)(?!.*(\s|:)$|.*:\s|-(\s|$)|---|\.\.\.|[-+]?\.(inf|nan)$)"
    r"[\w.+/-][\w.,:;+*/^%° ()'=-]*"
)


def yaml_text(value: object) -> str:
    """Returns a Python value as YAML text in one line, with quotes where YAML needs them."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {yaml_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(yaml_text, value)) + "]"
    if isinstance(value, str):
        plain = "," not in value and re.fullmatch(_NEEDS_NO_QUOTES, value) and is_plain_text(value)
        return value if plain else json.dumps(value, ensure_ascii=not value.isprintable())
    return str(value)


def edited(text: str, replacements: Mapping[Span, str]) -> str:
    """Returns the text of a YAML document with new text at some spans that do not overlap."""
    starts = [0, *(match.end() for match in re.finditer(r"\r\n|\r|\n", text))]
    for span in sorted(replacements, reverse=True):
        start = starts[span.line - 1] + span.column - 1
        end = starts[span.end_line - 1] + span.end_column - 1
        text = text[:start] + replacements[span] + text[end:]
    return text


def insertion(hint: str, mapping: Node, key: str, value: str, *, is_example: bool) -> Proposal:
    """Returns the hint that proposes to add an entry at the start of a YAML mapping.

    - ``hint``: text of the hint.
    - ``value``: YAML text of the value.
    """
    entries = mapping.value if isinstance(mapping.value, dict) else {}
    first = next(iter(entries.values()), None)
    start, entry = mapping.span, f"{key}: {value}"
    if first is not None and first.where.file != start.file:  # of a unit, in its design
        return Proposal(hint)
    if first is not None and first.where[:3] == start[:3]:
        # The keys of a YAML mapping without braces start in the same column.
        entry += "\n" + " " * (start.column - 1)
        column = start.column
    else:
        column = start.column + 1  # after the brace
        entry += ", " if first is not None else ""
    span = Span(start.file, start.line, column, start.line, column)
    return Proposal(hint, entry, span=span, is_example=is_example)


def removal(hint: str, mapping: Node, key: str) -> Proposal | str:
    """Returns the hint that proposes to remove an entry of a YAML mapping.

    Returns ``hint`` as plain text if the mapping has no other entry.
    """
    entries = list(mapping.value.items()) if isinstance(mapping.value, dict) else []
    # A value of a unit is no neighbour of those of its design.
    entries = [entry for entry in entries if entry[1].where.file == mapping.span.file]
    index = next((i for i, (name, _) in enumerate(entries) if name == key), None)
    if index is None or len(entries) < 2:
        return hint
    node = entries[index][1]
    if index + 1 < len(entries):
        start, end = node.where[1:3], entries[index + 1][1].where[1:3]
    else:
        start, end = entries[index - 1][1].span[3:5], node.span[3:5]
    if start >= end:  # An alias has the source span of its anchor.
        return hint
    return Proposal(hint, "", span=Span(node.span.file, *start, *end))


# -- values that a comma has split -----------------------------------------------

_ELEMENT = r"[+-]?\d[\w.+-]*( ?[A-Za-z°%][\w/^]*)?"
_DECIMAL_COMMA = r"[-+]?\d+,\d+(\s*[A-Za-z°%].*)?"


def is_decimal_comma(first: object, first_span: Span, second: object, span: Span) -> bool:
    """Returns whether two unquoted values with a comma and no space between them are a number."""
    is_number = re.fullmatch(_DECIMAL_COMMA, f"{first},{second}") is not None
    return is_number and span[1:3] == _after_comma(first_span)


def with_decimal_points(node: Node) -> list[str]:
    """Returns the elements of a list as text, in which `0,285` without a space is one number."""
    texts: list[str] = []
    last: Node | None = None
    for _, element in node.children():
        if last and is_decimal_comma(texts[-1], last.span, element.value, element.span):
            texts[-1] += f".{element.value}"
        else:
            texts.append(yaml_text(element.plain()))
        last = element
    return texts


def _after_comma(span: Span) -> tuple[int, int]:
    return span.end_line, span.end_column + 1


def report_decimal_comma(number: str, parts: str, span: Span, report: Report) -> None:
    """Reports a number with a decimal comma.

    - ``number``: the number with a decimal point.
    - ``parts``: what a comma separates, ``entries`` or ``elements``.
    """
    report.add(
        "bad-quantity",
        f"`{number.replace('.', ',', 1)}` is two {parts}: a comma separates {parts}",
        span,
        hint=Proposal(f"write a decimal point: `{number}`", number),
    )


def join_split_values(values: dict[str, Node], report: Report) -> dict[str, Node]:
    """Returns the entries of a YAML mapping in braces, with split values joined.

    YAML reads ``{width: 0,9 m}`` as two entries: ``width: 0`` and the key ``9 m`` without a value.
    Reports each split value.
    """
    if all(node.value is not None for node in values.values()):
        return values
    result: dict[str, Node] = {}
    lists: dict[str, list[Node]] = {}  # elements of lists without brackets
    for key, node in values.items():
        last_key, last = next(reversed(result.items()), (None, None))
        if last_key is None or last is None or node.value is not None or node.key_span is None:
            result[key] = node
            continue
        span = Span(last.span.file, *last.span[1:3], *node.key_span[3:5])
        if is_decimal_comma(last.value, last.span, key, node.key_span):
            text = f"{last.value}.{key}"
            report_decimal_comma(text, "entries", span, report)
            result[last_key] = Node(text, span, last.key_span)
        elif isinstance(last.value, str) and last.value.startswith("(") and not last.quoted:
            result[last_key] = Node(f"{last.value}, {key}", span, last.key_span)
        elif (
            node.key_span[1:3] != _after_comma(last.span)
            and _is_element(last)
            and re.fullmatch(_ELEMENT, key)
        ):
            element = Node(plain_scalar(key, node.key_span, report), node.key_span)
            elements = lists.setdefault(last_key, [last])
            elements.append(element)
            result[last_key] = Node(tuple(elements), span, last.key_span)
        else:
            result[key] = node
    for key in lists:
        text = "[" + ", ".join(str(element.value) for element in lists[key]) + "]"
        report.add(
            "wrong-type",
            f"`{key}` has {len(lists[key])} values without brackets; a comma ends an entry",
            result[key].span,
            hint=Proposal(f"write `{text}`", text),
        )
    return result


def _is_element(node: Node) -> bool:
    """Returns whether a value is a number or a quantity, or the start of a list of them."""
    if isinstance(node.value, tuple):
        return True
    return not isinstance(node.value, bool) and bool(re.fullmatch(_ELEMENT, str(node.value)))
