"""Spans, diagnostics and the report that collects them."""

from __future__ import annotations

import contextlib
import enum
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from thorvaldc.diagnostics.codes import CODES, Code


class Severity(enum.Enum):
    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


class Span(NamedTuple):  # which is made in half the time of a dataclass, and made a lot
    """A stretch of text in a file; lines and columns count from 1, the end is exclusive.

    ``file`` is the path as the user gave it (or relative to what they gave), so
    that messages and outputs do not depend on where a checkout lies.
    """

    file: str
    line: int = 1
    column: int = 1
    end_line: int = 1
    end_column: int = 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True, slots=True)
class Label:
    """A second place that belongs to a fault, with what is to be seen there."""

    span: Span
    text: str


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One fault: what is wrong (with value, limit and unit), where, and what to do."""

    code: Code
    message: str
    span: Span | None = None
    hint: str | None = None
    labels: tuple[Label, ...] = ()

    @property
    def severity(self) -> Severity:
        return Severity(self.code.severity)


class Report:
    """All faults of a run, in the order of discovery; ``sorted()`` orders by place."""

    def __init__(self) -> None:
        self._diagnostics: dict[Diagnostic, Diagnostic] = {}  # as said, and as kept
        self._user: Label | None = None

    def add(
        self,
        code: str,
        message: str,
        span: Span | None = None,
        *,
        hint: str | None = None,
        labels: Iterable[Label] = (),
    ) -> None:
        """Record a fault under the code named ``code`` (``"can-id-duplicate"``).

        An exact repetition is dropped: one mistake in a library module that is
        used nine times is one mistake.
        """
        self.put(Diagnostic(CODES[code], message, span, hint, tuple(labels)))

    def put(self, diagnostic: Diagnostic) -> None:
        """Record a fault that is there as a value."""
        kept, user, span = diagnostic, self._user, diagnostic.span
        if user is not None and span is not None and span.file != user.span.file:
            if span.file.startswith("<"):  # not a file of the user's own
                labels = (Label(span, "found here"), *kept.labels)
                kept = replace(kept, span=user.span, labels=labels)
            else:
                kept = replace(kept, labels=(*kept.labels, user))
        self._diagnostics.setdefault(diagnostic, kept)

    def extend(self, other: Report) -> None:
        for diagnostic in other:
            self.put(diagnostic)

    @contextlib.contextmanager
    def used_by(self, user: Label) -> Iterator[None]:
        """Faults found meanwhile in files other than ``user``'s get it as a label.

        So a fault in a module says who uses that module with such parameters.  One in
        the project's own library is put to the user's place, with a label where it was
        found: that is what the user can change.
        """
        outer, self._user = self._user, user
        try:
            yield
        finally:
            self._user = outer

    def __iter__(self) -> Iterator[Diagnostic]:
        return iter(self._diagnostics.values())

    def __len__(self) -> int:
        return len(self._diagnostics)

    @property
    def errors(self) -> list[Diagnostic]:
        return [d for d in self if d.severity is Severity.ERROR]

    @property
    def warnings(self) -> list[Diagnostic]:
        return [d for d in self if d.severity is Severity.WARNING]

    @property
    def has_errors(self) -> bool:
        return any(d.severity is Severity.ERROR for d in self._diagnostics)

    def sorted(self) -> list[Diagnostic]:
        """By file, line and column; faults without a place last."""
        last = Span("\U0010ffff")
        return sorted(self, key=lambda d: (d.span or last, d.code.number))

    def has_error_in(self, span: Span) -> bool:
        """Whether a value in that place is at fault; a key that is too many is none."""
        start, end = (span.line, span.column), (span.end_line, span.end_column)
        return any(
            d.span is not None
            and d.code.name != "unknown-key"
            and start <= (d.span.line, d.span.column) < end
            for d in self.errors
        )

    def excluding_spans_of(self, earlier: Report) -> Report:
        """What is said of places that ``earlier`` had no errors in."""
        known = {d.span for d in earlier.errors if d.span is not None}
        out = Report()
        for diagnostic in self:
            if diagnostic.span not in known:
                out.put(diagnostic)
        return out
