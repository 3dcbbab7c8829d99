"""Accepted warnings: the section ``accept`` of a document.

    accept:
      - {code: TV408, reason: the mast is removed on slopes}
      - {code: TV416, at: driver.max_linear_velocity, reason: tested at this speed}

An entry accepts the warnings with its code.  With ``at``, it accepts only those at one place of the
document, or in a module that is mounted there.  The entries of a module file accept the warnings in
that file.  Notes are accepted like warnings.  Errors cannot be accepted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import CODES, Code, Diagnostic, Report, Severity, Span
from thorvaldc.diagnostics.suggest import did_you_mean

SECTION = "accept"
_LATER = "68"
"""First digits of codes that commands after the compilation report: backends and simulation."""
_SHORT = ("modules", "robots")
"""Sections whose entries ``at`` can name without the name of the section."""


@dataclass
class Acceptance:
    """An entry of the section ``accept``.

    - ``code``: the accepted code.
    - ``reason``: the user's reason.
    - ``span``: the entry in the document.
    - ``file``: name of the document in spans.
    - ``place``: the key and value that ``at`` names, or ``None`` for the whole document.
    - ``is_module``: whether the document is a module file.
    - ``is_used``: whether a warning was accepted.
    """

    code: Code
    reason: str
    span: Span
    file: str
    place: Span | None
    is_module: bool
    is_used: bool = False

    def covers(self, diagnostic: Diagnostic) -> bool:
        """Returns whether the entry accepts a diagnostic."""
        if diagnostic.code != self.code:
            return False
        span = diagnostic.span
        is_here = span is not None and span.file == self.file
        if self.is_module and not is_here:
            return False
        if self.place is None:
            return True
        # A warning in a module file has a label at the module in the robot file.
        spans = [span] if is_here else [label.span for label in diagnostic.labels]
        return any(place is not None and _is_inside(place, self.place) for place in spans)


def read_acceptances(document: Node, report: Report, is_module: bool = False) -> list[Acceptance]:
    """Returns the entries of the section ``accept`` of a document.

    Entries that do not match the schema are left out.  Reports codes that are not those of
    warnings, and places that do not exist.
    """
    section = document.get(SECTION)
    entries: list[Acceptance] = []
    for entry in section.value if section is not None and isinstance(section.value, tuple) else ():
        code_node, reason = entry.get("code"), entry.get("reason")
        at = entry.get("at")
        if code_node is None or reason is None or not isinstance(code_node.value, str):
            continue
        code = _warning_code(code_node, report)
        place = _place(document, at, report) if at is not None else None
        if code is None or (at is not None and place is None):
            continue
        file = document.span.file
        entries.append(Acceptance(code, str(reason.value), entry.span, file, place, is_module))
    return entries


def accept_warnings(report: Report, acceptances: Iterable[Acceptance]) -> None:
    """Moves the warnings that an entry accepts to the accepted diagnostics of the report."""
    acceptances = list(acceptances)
    if not acceptances:
        return
    for diagnostic in report:
        matching = [entry for entry in acceptances if entry.covers(diagnostic)]
        for entry in matching:
            entry.is_used = True
        if matching:
            report.accept(diagnostic, matching[0].reason, matching[0].span)


def report_unused(acceptances: Iterable[Acceptance], report: Report) -> None:
    """Reports entries whose warning did not occur in a complete compilation."""
    for entry in acceptances:
        if not entry.is_used and entry.code.number[2] not in _LATER:
            code = f"{entry.code.severity} {entry.code.number} {entry.code.name}"
            report.add(
                "accept-unused",
                f"there is no {code} here any more",
                entry.span,
                hint="remove the entry",
            )


def _warning_code(node: Node, report: Report) -> Code | None:
    """Returns the code of a warning or note by its number or name."""
    word = str(node.value)
    known = {name: code for code in CODES.values() for name in (code.number, code.name)}
    code = known.get(word)
    error = Severity.ERROR.value
    warnings = [name for name, c in known.items() if c.severity != error]
    if code is None:
        report.add(
            "accept-code",
            f"there is no code `{word}`",
            node.span,
            hint=did_you_mean(word, warnings, "the code is in the warning, such as `TV408`"),
        )
    elif code.severity == error or code.name == "accept-unused":
        reason = "is an error" if code.severity == error else "is about this section"
        report.add(
            "accept-code",
            f"{code.number} {code.name} {reason}; only warnings and notes can be accepted",
            node.span,
            hint="correct the cause instead" if code.severity == error else "remove the entry",
        )
        return None
    return code


def _place(document: Node, at: Node, report: Report) -> Span | None:
    """Returns the span of the key and value that a path such as ``modules.fl.params`` names."""
    keys = str(at.value).split(".")
    node, known = document, _known(document)
    for number, key in enumerate(keys):
        child = _child(node, key)
        if child is None and number == 0:
            sections = (document.get(name) for name in _SHORT)
            child = next(
                (entry for s in sections if s is not None and (entry := _child(s, key))), None
            )
        if child is None:
            where = f"`{'.'.join(keys[:number])}` has no" if number else "the document has no"
            report.add(
                "accept-place",
                f"{where} `{key}`",
                at.span,
                hint=did_you_mean(key, known, fixable=len(keys) == 1),
            )
            return None
        node, known = child, list(child.value) if isinstance(child.value, dict) else []
    start = node.where
    return Span(start.file, start.line, start.column, node.span.end_line, node.span.end_column)


def _known(document: Node) -> list[str]:
    """Returns the first words of all places."""
    names = list(document.value) if isinstance(document.value, dict) else []
    for section in _SHORT:
        node = document.get(section)
        names += node.value if node is not None and isinstance(node.value, dict) else ()
    return names


def _child(node: Node, key: str) -> Node | None:
    if isinstance(node.value, tuple):
        return node.value[int(key)] if key.isdigit() and int(key) < len(node.value) else None
    return node.get(key)


def _is_inside(span: Span, place: Span) -> bool:
    start, end = (place.line, place.column), (place.end_line, place.end_column)
    return span.file == place.file and start <= (span.line, span.column) < end
