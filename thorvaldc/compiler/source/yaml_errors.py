"""Converts YAML syntax errors of the parser libyaml to diagnostics with plain messages and hints.

libyaml reports two positions of a syntax error.  The problem mark is the position at which the YAML
parser detected a syntax error.  The context mark is the start of the YAML list, mapping or text in
quotes around a syntax error.  If a closing bracket or quote is missing, the YAML parser can report
an error many lines after the mistake.  The error message for a missing bracket or quote therefore
shows the opening bracket or quote.

A document without errors needs this module only if it has characters that are not ASCII.
"""

from __future__ import annotations

import re
import unicodedata
from typing import Any, NamedTuple

import yaml

from thorvaldc.diagnostics import Label, Proposal, Report, Span

_EXPRESSION = 'inside `{...}` and `[...]` an expression must be quoted, as in `"${width}"`'

# Syntax errors of libyaml: (message of libyaml, message of the diagnostic, hint).
_MESSAGES: tuple[tuple[str, str, str], ...] = (
    (
        "mapping values are not allowed",
        "a `:` is not allowed here",
        "quote text that contains `: `, or check the indentation of this line and the line before",
    ),
    (
        "could not find expected ':'",
        "a `:` is missing after a key",
        "write `key: value` with a space after the colon",
    ),
    (
        "did not find expected key",
        "expected a key",
        "the keys of one mapping start in the same column",
    ),
    (
        "did not find expected '-' indicator",
        "a key between the elements of a list",
        "all elements of a list start with `-` in the same column; the keys of a mapping do not",
    ),
    (
        "block sequence entries are not allowed",
        "an element of a list is not allowed here",
        "start the list on a new line",
    ),
    (
        "did not find expected ',' or ']'",
        "a `,` or the closing `]` is missing",
        "",
    ),
    (
        "did not find expected ',' or '}'",
        "a `,` or the closing `}` is missing",
        "",
    ),
    ("did not find expected node content", "a value is missing here", ""),
    ("found unexpected ':'", "a value or a space is missing after this `:`", "write `key: value`"),
    (
        "found undefined alias",
        "no anchor has this name",
        "quote the value if it is text that starts with `*`",
    ),
    ("found duplicate anchor", "another anchor has this name", "choose another name"),
    (
        "did not find expected alphabetic or numeric character",
        "a name is missing after `*` or `&`",
        "quote the value if it is text",
    ),
    (
        "found unknown escape character",
        "this escape is not allowed in double quotes",
        "use single quotes, or write `\\\\` for a backslash",
    ),
    ("found undefined tag handle", "unknown tag", "remove the tag; quote text"),
    (
        "did not find expected whitespace or line break",
        "a space is missing here",
        "quote text that starts with `!`, `&`, `*` or `|`",
    ),
    (
        "did not find expected comment or line break",
        "only a comment is allowed after this",
        "quote text that starts with `|` or `>`",
    ),
    (
        "did not find expected <document start>",
        "the document ends before this line",
        "a file contains one mapping; check the indentation",
    ),
    (
        "control characters are not allowed",
        "a control character is not allowed in YAML",
        "remove it",
    ),
)


def explain(error: yaml.MarkedYAMLError, text: str, file: str, report: Report) -> None:
    """Adds the diagnostic for a YAML syntax error to ``report``.

    - ``error``: syntax error that PyYAML raised.
    - ``text``: text of the document.
    - ``file``: file name in source spans.
    """
    problem = str(error.problem or error.context or "unknown error")
    context = str(error.context or "")
    lines = text.splitlines() or [""]
    mark = error.problem_mark or error.context_mark
    span = _span(mark, lines, file)
    opened = error.context_mark

    if "but found another document" in problem or "expected a single document" in context:
        report.add(
            "yaml-several-documents",
            "a second document starts here; a file contains one",
            span,
            hint="move it to another file",
        )
        return
    line = lines[span.line - 1] if span.line <= len(lines) else ""
    character = _character(lines, span)
    tab = _tab(line, span)
    if tab is not None and ("token" in problem or "indentation" in problem or "tab" in problem):
        report.add(
            "yaml-tab",
            "YAML does not allow tabs for indentation",
            Span(file, span.line, tab, span.line, tab + 1),
            hint="use spaces",
        )
        return
    labels: list[Label] = []
    hint: str | None
    is_flow = opened is not None and context.startswith("while parsing a flow")
    started = _span(opened, lines, file) if opened is not None else span
    if not (is_flow and _is_unclosed(lines, started, span)):
        first = started.line if "parsing a block" not in context else span.line
        cause = find_cause(problem, lines, span, first)
        if cause is not None:
            detected = cause.labels(span)
            report.add(cause.code, cause.message, cause.span, hint=cause.hint, labels=detected)
            return
    if "end of stream" in problem and opened is not None:
        message, hint = "the text in quotes that starts here has no end", "add the closing quote"
        span = _span(opened, lines, file)
    elif "cannot start any token" in problem:
        message = f"unquoted text cannot start with `{character}`"
        hint = _quotes_hint(line, span)
    else:
        for yaml_message, plain_message, advice in _MESSAGES:
            if yaml_message in problem:
                message, hint = plain_message, advice or None
                break
        else:
            message, hint = f"invalid YAML: {problem}", None
        if is_flow:
            start = started
            if "${" in line:
                hint = _EXPRESSION
            if _is_unclosed(lines, start, span):
                message = f"this `{_character(lines, start)}` is not closed"
                labels.append(Label(span, "the error is detected here"))
                span = start
            else:
                labels.append(Label(start, "opened here"))
    report.add("yaml-syntax", message, span, hint=hint, labels=labels)


def _quotes_hint(line: str, span: Span) -> str:
    """Returns the hint to put the rest of a line in quotes."""
    value = line[span.column - 1 :].rstrip()
    if not value or any(character in value for character in '"\\,#]}'):
        return "put it in quotes"
    end = span.column + len(value)
    whole = Span(span.file, span.line, span.column, span.line, end)
    return Proposal("put it in quotes", f'"{value}"', span=whole)


def _is_unclosed(lines: list[str], opened: Span, stopped: Span) -> bool:
    """Returns whether a closing bracket is probably missing in a YAML file.

    - ``opened``: source span of the opening bracket.
    - ``stopped``: source span at which the parser stopped.

    A closing bracket is probably missing if the YAML parser stops at a later line that is not
    indented more than the line of the opening bracket.
    """

    def indentation(number: int) -> int:
        text = lines[number - 1] if number <= len(lines) else ""
        return len(text) - len(text.lstrip())

    return stopped.line > opened.line and indentation(stopped.line) <= indentation(opened.line)


def _character(lines: list[str], span: Span) -> str:
    line = lines[span.line - 1] if span.line <= len(lines) else ""
    return line[span.column - 1 : span.column]


def _span(mark: Any, lines: list[str], file: str) -> Span:
    """Returns the line and column of a PyYAML mark as a source span of one character.

    If the PyYAML mark is after the last line, returns the source span after the last character of
    the text.
    """
    if mark is None:
        return Span(file)
    line, column = mark.line + 1, mark.column + 1
    if line > len(lines):
        line, column = len(lines), len(lines[-1]) + 1
    return Span(file, line, column, line, column + 1)


def _tab(line: str, span: Span) -> int | None:
    """Returns the column of the tab that causes a YAML syntax error, or ``None``.

    A tab in the indentation of a YAML line or at the position of a syntax error causes the error.
    """
    indentation = line[: len(line) - len(line.lstrip())]
    if "\t" in indentation:
        return indentation.index("\t") + 1
    return span.column if line[span.column - 1 : span.column] == "\t" else None


# -- probable causes --------------------------------------------------------------

# libyaml detects many mistakes too late.  For example, a missing colon is detected at the next key.


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

    def before(self, number: int = 0) -> int:
        """Returns the number of the last line with content before a line, or before the error."""
        number = (number or self.detected.line) - 1
        while number > 0 and self.text(number).lstrip()[:1] in ("", "#"):
            number -= 1
        return number

    def column_of_keys(self, here: int) -> int:
        """Returns the indentation of the mapping that a wrongly indented key probably belongs to.

        It is the nearest one above; of two equally near ones, that of the line below.
        """
        columns = [_indentation(self.text(self.before()))]
        for number in range(self.before(), 0, -1):
            if self.text(number) and (column := _indentation(self.text(number))) < columns[-1]:
                columns.append(column)
        line_below = self.text(self.detected.line + 1)
        below = _indentation(line_below) if line_below else columns[0]
        return min(columns, key=lambda column: (abs(column - here), column != below))

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
            match = QUOTE_BEFORE_VALUE.search(self.text(number))
            if match:
                start, text = match.start(1), self.text(number)
                span = self.span(number, start, start + 1)
                message = quote_message(match[1], span)
                hint = QUOTE_HINT
                quoted = QUOTED.match(text, start)
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
            opening = self.text(self.before(number))
            if opening.endswith(":") and _indentation(opening) == above:
                return Cause(
                    f"this line starts in the column of `{opening.strip()}`, which has no value",
                    self.span(number, 0, above),
                    Proposal(f"start the line in column {here + 1}", " " * here),
                )
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
            Proposal(
                "the keys of one mapping start in the same column",
                " " * self.column_of_keys(here),
            ),
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
        start = len(self.line[:end].rstrip("; "))
        hint = Proposal(
            "separate the entries by commas", ",", span=self.span(self.detected.line, start, end)
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


# -- characters that look like spaces and quotes -----------------------------------

# Word processors, web pages and some keyboards insert such characters.  In the text of a
# description they are allowed.

_SPACES = {
    "\u00a0": "a no-break space",
    "\u2007": "a figure space",
    "\u2009": "a thin space",
    "\u200b": "a zero-width space",
    "\u202f": "a narrow no-break space",
    "\u2060": "a word joiner",
    "\u3000": "an ideographic space",
}
_INVISIBLE = "[\u00ad\u200b-\u200d\u2060]"
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
    ascii_text = re.sub("[\u2010-\u2015]", "-", re.sub(_INVISIBLE, "", text))
    if ascii_text != text and re.fullmatch(r"[-\w./+:*]+ ?[\w/^*]*", ascii_text, re.ASCII):
        character = next(c for c in text if not c.isascii())
        report.add(
            "yaml-character",
            f"the character {unicodedata.name(character).lower()} (U+{ord(character):04X}) in "
            f"`{ascii_text}` is no part of a name or a number",
            span,
            hint=Proposal(f"write `{ascii_text}`", ascii_text),
        )
        return ascii_text
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
