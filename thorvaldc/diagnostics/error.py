"""An exception that carries a diagnostic."""

from __future__ import annotations

from thorvaldc.diagnostics.codes import CODES
from thorvaldc.diagnostics.report import Diagnostic, Span


class DiagnosticError(Exception):
    """Raised if an operation is not possible.

    - ``diagnostic``: diagnostic with the reason and a hint.

    A function without a ``Report`` raises this exception.  A caller with a ``Report`` adds the
    diagnostic to its report.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic(CODES[code], message, span, hint)
