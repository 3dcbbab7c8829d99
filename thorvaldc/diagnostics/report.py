"""Spans, diagnostics and the report that collects them."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from thorvaldc.diagnostics.codes import CODES, Code


class Severity(enum.Enum):
    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True, order=True)
class Span:
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
        self._diagnostics: dict[Diagnostic, None] = {}  # in order, each once

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
        self._diagnostics[diagnostic] = None

    def extend(self, other: Report) -> None:
        self._diagnostics.update(other._diagnostics)

    def __iter__(self) -> Iterator[Diagnostic]:
        return iter(self._diagnostics)

    def __len__(self) -> int:
        return len(self._diagnostics)

    @property
    def errors(self) -> list[Diagnostic]:
        return [d for d in self._diagnostics if d.severity is Severity.ERROR]

    @property
    def warnings(self) -> list[Diagnostic]:
        return [d for d in self._diagnostics if d.severity is Severity.WARNING]

    @property
    def has_errors(self) -> bool:
        return any(d.severity is Severity.ERROR for d in self._diagnostics)

    def sorted(self) -> list[Diagnostic]:
        """By file, line and column; faults without a place last."""
        last = Span("\U0010ffff")
        return sorted(self._diagnostics, key=lambda d: (d.span or last, d.code.number))
