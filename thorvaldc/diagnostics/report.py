"""Source spans, diagnostics and the report that collects them."""

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


# A named tuple: it is created in half the time of a frozen dataclass, and every YAML value has one.
class Span(NamedTuple):
    """A range of text in a file.  Lines and columns count from 1; the end is exclusive.

    ``file`` is the path as the user gave it, or relative to that path: messages and
    outputs do not depend on the folder of a checkout.
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
    """A secondary span of a diagnostic, with a text such as ``first used here``."""

    span: Span
    text: str


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """A message about an input: code, text (with value, limit and unit), span and hint."""

    code: Code
    message: str
    span: Span | None = None
    hint: str | None = None
    labels: tuple[Label, ...] = ()

    @property
    def severity(self) -> Severity:
        return Severity(self.code.severity)


class Report:
    """All diagnostics of a run in the order of detection; ``sorted()`` orders them by span."""

    def __init__(self) -> None:
        # As reported, to detect repetitions -> with the label of `used_by`.
        self._diagnostics: dict[Diagnostic, Diagnostic] = {}
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
        """Adds a diagnostic with the code of that name (``"can-id-duplicate"``).

        An exact repetition is dropped: a mistake in a library module that is used nine
        times is reported once.
        """
        self.put(Diagnostic(CODES[code], message, span, hint, tuple(labels)))

    def put(self, diagnostic: Diagnostic) -> None:
        """Adds a diagnostic; an exact repetition is dropped."""
        labelled, user, span = diagnostic, self._user, diagnostic.span
        if user is not None and span is not None and span.file != user.span.file:
            if span.file.startswith("<"):  # the project's library: the user cannot change it
                labels = (Label(span, "found here"), *labelled.labels)
                labelled = replace(labelled, span=user.span, labels=labels)
            else:
                labelled = replace(labelled, labels=(*labelled.labels, user))
        self._diagnostics.setdefault(diagnostic, labelled)

    def extend(self, diagnostics: Iterable[Diagnostic]) -> None:
        """Adds diagnostics in their order."""
        for diagnostic in diagnostics:
            self.put(diagnostic)

    @contextlib.contextmanager
    def used_by(self, user: Label) -> Iterator[None]:
        """Adds the label ``user`` to diagnostics in other files than that of ``user``.

        A diagnostic in a module then names the module instance whose parameters cause it.
        A diagnostic in the project's library gets the span of ``user``, which the user can
        change, and a label at its original span.
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
        """Returns the diagnostics by file, line and column; those without a span come last."""
        last = Span("\U0010ffff")
        return sorted(self, key=lambda d: (d.span or last, d.code.number))

    def has_error_in(self, span: Span) -> bool:
        """Returns whether an error starts inside the span.  An unknown key does not count."""
        start, end = (span.line, span.column), (span.end_line, span.end_column)
        return any(
            d.span is not None
            and d.code.name != "unknown-key"
            and start <= (d.span.line, d.span.column) < end
            for d in self.errors
        )

    def excluding_spans_of(self, earlier: Report) -> Report:
        """Returns the diagnostics at spans where ``earlier`` has no error."""
        known = {d.span for d in earlier.errors if d.span is not None}
        remaining = Report()
        remaining.extend(d for d in self if d.span not in known)
        return remaining
