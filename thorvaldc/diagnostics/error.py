"""An exception that carries a diagnostic."""

from __future__ import annotations

from thorvaldc.diagnostics.codes import CODES
from thorvaldc.diagnostics.report import Diagnostic, Span


class DiagnosticError(Exception):
    """An operation is not possible; ``diagnostic`` holds the reason and a hint.

    Raised by code that has no ``Report``.  A caller that has one adds ``diagnostic`` to it.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic(CODES[code], message, span, hint)
