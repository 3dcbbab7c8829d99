"""Converts YAML syntax errors of the parser libyaml to diagnostics with plain messages and hints.

libyaml reports two positions of a syntax error.  The problem mark is the position at which the YAML
parser detected a syntax error.  The context mark is the start of the YAML list, mapping or text in
quotes around a syntax error.  If a closing bracket or quote is missing, the YAML parser can report
an error many lines after the mistake.  The error message for a missing bracket or quote therefore
shows the opening bracket or quote.
"""

from __future__ import annotations

from typing import Any

import yaml

from thorvaldc.compiler.source.yaml_causes import find_cause
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
