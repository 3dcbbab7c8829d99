"""Finds the probable cause of a YAML syntax error in the lines around the error.

libyaml detects many mistakes too late.  For example, a missing colon is detected at the next key.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from thorvaldc.compiler.source import lookalikes
from thorvaldc.diagnostics import Label, Proposal, Span


class Cause(NamedTuple):
    """Probable cause of a YAML syntax error.

    - ``message``, ``span``, ``hint``: as in a diagnostic.
    - ``code``: name of the diagnostic code.
    """

    message: str
    span: Span
    hint: str
    code: str = "yaml-syntax"

    def labels(self, detected: Span) -> list[Label]:
        """Returns the label at the position at which libyaml detected the error."""
        elsewhere = detected.line != self.span.line
        return [Label(detected, "the error is detected here")] if elsewhere else []


_WORD = r"[A-Za-z_][\w.-]*"
_NO_COLON = re.compile(rf"( *(?:- )?)({_WORD})( +\S.*)?")
_NO_SPACE = re.compile(rf"( *(?:- )?)({_WORD}):(\S.*)")
_EQUALS = re.compile(rf"( *(?:- )?)({_WORD})( *= *)(\S.*)")
_ENTRY = re.compile(rf"( *(?:- )?{_WORD}: +)([^\s\"'\[{{|>&*!#].*)")
_CONFLICT = re.compile(r"(<<<<<<<|=======|>>>>>>>|\|\|\|\|\|\|\|)( .*)?$")
_OTHER_COMMENT = re.compile(r" *(//|/\*|--|;|%)(?: |$)")
_MAPPING_IN_PARENTHESES = re.compile(rf"\(({_WORD}: .*)\)")
_ENTRIES = re.compile(rf"{_WORD}: [^,]+(, *{_WORD}: .*)+")
_KEY_BEFORE = re.compile(rf"\s({_WORD})\s*$")


def find_cause(problem: str, lines: list[str], detected: Span, started: int) -> Cause | None:
    """Returns the probable cause of a YAML syntax error, or ``None`` if it is not known.

    - ``problem``: message of libyaml.
    - ``lines``: lines of the document.
    - ``detected``: position at which libyaml detected the error.
    - ``started``: line at which the erroneous part of the document starts.
    """
    search = _Search(lines, detected, min(started, detected.line))
    methods = [method for text, method in _METHODS.items() if text in problem]
    for method in (_Search.conflict, _Search.quote, _Search.comment, *methods):
        cause = method(search)
        if cause is not None:
            return cause
    return None


class _Search:
    """Looks for the cause of one YAML syntax error."""

    def __init__(self, lines: list[str], detected: Span, started: int) -> None:
        self.lines = lines
        self.detected = detected
        self.started = started
        self.line = self.text(detected.line)

    def text(self, number: int) -> str:
        return self.lines[number - 1].rstrip() if 0 < number <= len(self.lines) else ""

    def span(self, line: int, start: int, end: int) -> Span:
        """Returns the source span of the characters from ``start`` to ``end``, both from 0."""
        return Span(self.detected.file, line, start + 1, line, end + 1)

    def before(self) -> int:
        """Returns the number of the last line before the error that has content."""
        number = self.detected.line - 1
        while number > 0 and self.text(number).lstrip()[:1] in ("", "#"):
            number -= 1
        return number

    def conflict(self) -> Cause | None:
        for number in range(min(self.started, self.before()), self.detected.line + 1):
            match = _CONFLICT.match(self.text(number))
            if match:
                return Cause(
                    "this line is a conflict marker of a version control system",
                    self.span(number, 0, len(match[1])),
                    "keep one of the two versions and remove the markers",
                )
        return None

    def quote(self) -> Cause | None:
        for number in range(self.started, self.detected.line + 1):
            match = lookalikes.QUOTE_BEFORE_VALUE.search(self.text(number))
            if match:
                start, text = match.start(1), self.text(number)
                span = self.span(number, start, start + 1)
                message = lookalikes.quote_message(match[1], span)
                hint = lookalikes.QUOTE_HINT
                quoted = lookalikes.QUOTED.match(text, start)
                if quoted:
                    whole = self.span(number, start, quoted.end())
                    hint = Proposal(hint, f'"{quoted[1]}"', span=whole)
                return Cause(message, span, hint, "yaml-character")
        return None

    def comment(self) -> Cause | None:
        for number in range(min(self.started, self.before()), self.detected.line + 1):
            match = _OTHER_COMMENT.match(self.text(number))
            if match:
                span = self.span(number, match.start(1), match.end(1))
                return Cause(
                    f"`{match[1]}` does not start a comment in YAML",
                    span,
                    Proposal("write `#`", "#"),
                )
        return None

    def key_without_colon(self, number: int) -> Cause | None:
        """Returns the cause if the line ``number`` is a key without a colon."""
        text = self.text(number).partition(" #")[0].rstrip()
        equals = _EQUALS.fullmatch(text)
        if equals:
            start, end = equals.span(3)
            span = self.span(number, start, end)
            return Cause(
                f"a `=` after the key `{equals[2]}`; expected a `:`",
                span,
                Proposal(f"write `{equals[2]}: {equals[4]}`", ": "),
            )
        no_space = _NO_SPACE.fullmatch(text)
        if no_space:
            colon = no_space.end(2)
            place = self.span(number, colon + 1, colon + 1)
            hint = f"write `{no_space[2]}: {no_space[3]}`"
            span = self.span(number, colon, colon + 1)
            return Cause("a space is missing after this `:`", span, Proposal(hint, " ", span=place))
        match = _NO_COLON.fullmatch(text)
        if match is None:
            return None
        place = self.span(number, match.end(2), match.end(2))
        hint = f"write `{match[2]}:{match[3] or ''}`"
        if match[3] and _ENTRY.fullmatch(self.text(number - 1)):
            hint += ", or indent the line if it continues the text above"
        span = self.span(number, match.start(2), match.end(2))
        return Cause(f"a `:` is missing after `{match[2]}`", span, Proposal(hint, ":", span=place))

    def simple_key(self) -> Cause | None:
        return self.key_without_colon(self.started)

    def second_colon(self) -> Cause | None:
        """Causes of a `:` where none is allowed: in this line, or in the line above."""
        number = self.before()
        cause = self.key_without_colon(number)
        if cause is not None:
            return cause
        above, here = _indentation(self.text(number)), _indentation(self.line)
        entry = _ENTRY.fullmatch(self.text(number))
        if here > above and entry is not None and self.detected.column > here:
            return Cause(
                "this line is indented more than the line above, which has a value already",
                self.span(self.detected.line, 0, here),
                Proposal(f"start the line in column {above + 1}", " " * above),
            )
        entry = _ENTRY.fullmatch(self.line)
        if entry is None or ": " not in entry[2]:
            return None
        inner = _MAPPING_IN_PARENTHESES.fullmatch(entry[2])
        inner_text = inner[1] if inner else entry[2] if _ENTRIES.fullmatch(entry[2]) else ""
        if inner_text:
            value = self.span(self.detected.line, entry.start(2), entry.end(2))
            hint = Proposal(
                "write a mapping in one line in braces", f"{{{inner_text}}}", span=value
            )
            return Cause("a `:` is not allowed here", self.detected, hint)
        quoted = '"' + entry[2].replace("\\", "\\\\").replace('"', '\\"') + '"'
        value = self.span(self.detected.line, entry.start(2), entry.end(2))
        hint = Proposal("quote text that contains `: `", quoted, span=value)
        return Cause("a `:` is not allowed here", self.detected, hint)

    def key(self) -> Cause | None:
        """Causes of a text where a key is expected."""
        column = self.detected.column - 1
        if self.line[column : column + 1] in ("}", "]"):
            span = self.span(self.detected.line, column, column + 1)
            message = f"this `{self.line[column]}` closes nothing"
            return Cause(message, span, Proposal("remove it", ""))
        before = self.line[:column].rstrip()
        if before[-1:] == '"':
            for number in range(self.detected.line - 1, 0, -1):
                start = self.text(number).find('"')
                if self.text(number).count('"') % 2 and "#" not in self.text(number):
                    span = self.span(number, start, start + 1)
                    return Cause("the closing quote is missing", span, 'add the closing `"`')
        if self.line.lstrip().startswith("- ") and not before:
            dash = _indentation(self.line)
            return Cause(
                "an element of a list between the keys of a mapping",
                self.span(self.detected.line, dash, dash + 2),
                Proposal("remove the `-`", ""),
            )
        if before[-1:] in ("'", '"'):
            message = f"text after the closing `{before[-1]}`"
            hint = "write `''` for a quote inside single quotes, or use double quotes around it"
            if before[-1] == '"':
                hint = (
                    'write `\\"` for a quote inside double quotes, or use single quotes around it'
                )
            return Cause(message, self.detected, hint)
        above, here = _indentation(self.text(self.before())), _indentation(self.line)
        if before or above == here or self.text(self.before()).endswith(":"):
            return None
        return Cause(
            f"this key starts in column {here + 1}; the line above starts in column {above + 1}",
            self.span(self.detected.line, 0, here),
            Proposal("the keys of one mapping start in the same column", " " * above),
        )

    def comma(self) -> Cause | None:
        """Causes of a missing comma in a mapping or list in brackets."""
        column = self.detected.column - 1
        if self.line[column : column + 1] == ":":
            match = _KEY_BEFORE.search(self.line[:column])
            column = match.start(1) if match else column
        word = re.match(_WORD, self.line[column:])
        if word is None or "${" in self.line:
            return None
        end = len(self.line[:column].rstrip())
        hint = Proposal(
            "separate the entries by commas", ",", span=self.span(self.detected.line, end, end)
        )
        span = self.span(self.detected.line, column, column + word.end())
        return Cause(f"a `,` is missing before `{word[0]}`", span, hint)


_METHODS = {
    "could not find expected ':'": _Search.simple_key,
    "mapping values are not allowed": _Search.second_colon,
    "did not find expected key": _Search.key,
    "did not find expected ',' or": _Search.comma,
}


def _indentation(text: str) -> int:
    return len(text) - len(text.lstrip(" "))
