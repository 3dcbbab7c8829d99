"""YAML's syntax errors in plain words."""

from __future__ import annotations

from typing import Any

import yaml

from thorvaldc.diagnostics import Label, Report, Span

_EXPRESSION = 'inside `{...}` and `[...]` an expression must be quoted, as in `"${width}"`'

# What libyaml says, what we say, what to do.
_WORDS: tuple[tuple[str, str, str], ...] = (
    (
        "mapping values are not allowed",
        "a `:` cannot stand here",
        "quote text that has `: ` in it, or check the indentation of this line and the one before",
    ),
    (
        "could not find expected ':'",
        "a `:` is missing after a key",
        "write `key: value` with a space after the colon",
    ),
    (
        "did not find expected key",
        "a key is wanted here",
        "the keys of one mapping begin in the same column",
    ),
    (
        "did not find expected '-' indicator",
        "the next element of the list is wanted here",
        "the elements of one list begin with `-` in the same column",
    ),
    (
        "block sequence entries are not allowed",
        "an element of a list cannot stand here",
        "begin the list on a line of its own",
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
    ("found unexpected ':'", "a space is missing after this `:`", "write `key: value`"),
    (
        "found undefined alias",
        "there is no anchor of this name",
        "quote the value if it is text that begins with `*`",
    ),
    ("found duplicate anchor", "this anchor's name is in use", "give it another name"),
    (
        "did not find expected alphabetic or numeric character",
        "a name is missing after `*` or `&`",
        "quote the value if it is text",
    ),
    (
        "found unknown escape character",
        "there is no such escape in double quotes",
        "use single quotes, or write `\\\\` for a backslash",
    ),
    ("found undefined tag handle", "this tag is not known", "leave it off; quote text"),
    (
        "did not find expected whitespace or line break",
        "a space is missing here",
        "quote text that begins with `!`, `&`, `*` or `|`",
    ),
    (
        "did not find expected comment or line break",
        "only a comment can follow here",
        "quote text that begins with `|` or `>`",
    ),
    (
        "did not find expected <document start>",
        "the document has ended before this",
        "a file holds one mapping; check the indentation",
    ),
    (
        "control characters are not allowed",
        "a control character is not allowed in YAML",
        "remove it",
    ),
)


def explain(error: yaml.MarkedYAMLError, text: str, file: str, report: Report) -> None:
    """Add the diagnostic for a syntax error that PyYAML raised on ``text``."""
    problem = str(error.problem or error.context or "this cannot be read")
    context = str(error.context or "")
    lines = text.splitlines() or [""]
    mark = error.problem_mark or error.context_mark
    span = _span(mark, lines, file)
    opened = error.context_mark

    if "but found another document" in problem or "expected a single document" in context:
        report.add(
            "yaml-several-documents",
            "a second document begins here; a file holds one",
            span,
            hint="put it in a file of its own",
        )
        return
    line = lines[span.line - 1] if span.line <= len(lines) else ""
    character = _character(lines, span)
    tab = _tab(line, span)
    if tab is not None and ("token" in problem or "indentation" in problem or "tab" in problem):
        report.add(
            "yaml-tab",
            "a tab cannot indent in YAML",
            Span(file, span.line, tab, span.line, tab + 1),
            hint="use spaces",
        )
        return
    labels: list[Label] = []
    hint: str | None
    if "end of stream" in problem and opened is not None:
        message, hint = "the quote that opens here is never closed", "close it"
        span = _span(opened, lines, file)
    elif "cannot start any token" in problem:
        message = f"text cannot begin with `{character}` unquoted"
        hint = "put it in quotes"
    else:
        for theirs, ours, advice in _WORDS:
            if theirs in problem:
                message, hint = ours, advice or None
                break
        else:
            message, hint = f"this is not YAML: {problem}", None
        if opened is not None and context.startswith("while parsing a flow"):
            start = _span(opened, lines, file)
            if "${" in line:
                hint = _EXPRESSION
            if _is_outside(lines, start, span):
                message = f"this `{_character(lines, start)}` is never closed"
                labels.append(Label(span, "reading stopped here"))
                span = start
            else:
                labels.append(Label(start, "opened here"))
    report.add("yaml-syntax", message, span, hint=hint, labels=labels)


def _is_outside(lines: list[str], opened: Span, stopped: Span) -> bool:
    """Whether reading stopped on a line that is no deeper than the one with the bracket."""

    def indentation(number: int) -> int:
        text = lines[number - 1] if number <= len(lines) else ""
        return len(text) - len(text.lstrip())

    return stopped.line > opened.line and indentation(stopped.line) <= indentation(opened.line)


def _character(lines: list[str], span: Span) -> str:
    line = lines[span.line - 1] if span.line <= len(lines) else ""
    return line[span.column - 1 : span.column]


def _span(mark: Any, lines: list[str], file: str) -> Span:
    """One character; a mark past the end of the text is drawn back to its end."""
    if mark is None:
        return Span(file)
    line, column = mark.line + 1, mark.column + 1
    if line > len(lines):
        line, column = len(lines), len(lines[-1]) + 1
    return Span(file, line, column, line, column + 1)


def _tab(line: str, span: Span) -> int | None:
    """The column of a tab in the line's indentation or at the error itself."""
    indentation = line[: len(line) - len(line.lstrip())]
    if "\t" in indentation:
        return indentation.index("\t") + 1
    return span.column if line[span.column - 1 : span.column] == "\t" else None
