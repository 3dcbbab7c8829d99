"""The exception that carries a diagnostic to whoever reports it."""

from __future__ import annotations

from thorvaldc.diagnostics.codes import CODES
from thorvaldc.diagnostics.report import Diagnostic, Span


class DiagnosticError(Exception):
    """Something cannot be run; ``diagnostic`` says what, and what to do.

    Raised where there is no report at hand; whoever has one adds the
    diagnostic to it.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic(CODES[code], message, span, hint)
