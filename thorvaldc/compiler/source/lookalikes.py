"""Finds characters that look like the spaces and quotes of YAML, but are others.

Word processors, web pages and some keyboards insert such characters.  In the text of a description
they are allowed.
"""

from __future__ import annotations

import re

from thorvaldc.diagnostics import Proposal, Report, Span

_SPACES = {
    "\u00a0": "a no-break space",
    "\u2007": "a figure space",
    "\u2009": "a thin space",
    "\u200b": "a zero-width space",
    "\u202f": "a narrow no-break space",
    "\u2060": "a word joiner",
    "\u3000": "an ideographic space",
}
_SPACE = "[" + "".join(_SPACES) + "]"

STRUCTURAL_SPACE = re.compile(
    rf"(?:^[ ]*(?:-[ ]+)?|[{{,][ ]*)(?:(?P<first>{_SPACE})"
    rf"|[\w.-]+(?P<before>{_SPACE}+)[ ]*:(?=\s|$)|[\w.-]+[ ]*:(?P<after>{_SPACE}))"
    rf"|^[ ]*-(?P<item>{_SPACE})",
    re.MULTILINE,
)
"""A space that is not that of YAML in an indentation, beside a key, or after a `:` or `-`."""

_OPENING_QUOTES = "\u201c\u201d\u201e\u201f\u2018\u2019\u201a\u201b\u00ab\u00bb\u00b4"
QUOTE_BEFORE_VALUE = re.compile(rf"(?:^|: |- |[\[,{{]) *([{_OPENING_QUOTES}])")
"""A typographic quote at the start of a value."""
QUOTED = re.compile(rf"[{_OPENING_QUOTES}]([^{_OPENING_QUOTES}\"\\]*)[{_OPENING_QUOTES}]")
"""A text in typographic quotes."""


QUOTE_HINT = "write `\"` or `'`"


def report_space(character: str, span: Span, report: Report) -> None:
    """Reports a character that looks like a space."""
    name = _SPACES.get(character, "a special space")
    report.add(
        "yaml-character",
        f"{name} (U+{ord(character):04X}) in column {span.column}: it looks like a space, but YAML"
        " does not read it as one",
        span,
        hint=Proposal("write a normal space", " "),
    )


def corrected(text: str, span: Span, report: Report) -> str:
    """Returns an unquoted scalar without typographic quotes and without special spaces at its ends.

    Reports these characters.
    """
    for index in (0, -1):
        if text and text[index] in _SPACES:
            column = span.column if index == 0 else span.end_column - 1
            line = span.line if index == 0 else span.end_line
            report_space(text[index], Span(span.file, line, column, line, column + 1), report)
            return text.strip("".join(_SPACES) + " ")
    if len(text) > 1 and text[0] in _OPENING_QUOTES and text[-1] in _OPENING_QUOTES:
        inner = text[1:-1]
        report_quote(text[0], span, report, replacement=f'"{inner}"')
        return inner
    return text


def report_quote(character: str, span: Span, report: Report, replacement: str) -> None:
    """Reports a typographic quote at the start of ``span``.

    - ``replacement``: the whole text of ``span`` with the quotes of YAML.
    """
    report.add(
        "yaml-character",
        quote_message(character, span),
        span,
        hint=Proposal(QUOTE_HINT, replacement),
    )


def quote_message(character: str, span: Span) -> str:
    return (
        f"`{character}` (U+{ord(character):04X}) in column {span.column} is a typographic quote;"
        " it does not quote text in YAML"
    )
