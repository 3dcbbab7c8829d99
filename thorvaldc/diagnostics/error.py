"""A Python exception that contains a diagnostic."""

from __future__ import annotations

from thorvaldc.diagnostics.codes import CODES
from thorvaldc.diagnostics.report import Diagnostic, Proposal, Span


class DiagnosticError(Exception):
    """Raised if an operation fails for the reason in the diagnostic.

    - ``diagnostic``: diagnostic with the reason and a hint.

    A function without a parameter of the type ``Report`` raises ``DiagnosticError`` instead of
    adding to a report.  A caller that has a ``Report`` adds the diagnostic of the exception to the
    report.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(message)
        fixes = hint.fixes(span) if isinstance(hint, Proposal) and span is not None else ()
        self.diagnostic = Diagnostic(CODES[code], message, span, hint, fixes=fixes)
        if hint:
            self.add_note(f"hint: {hint}")  # a traceback shows it below the message

    @property
    def one_line(self) -> str:
        """The message and the hint in one line."""
        return "; ".join(filter(None, (self.diagnostic.message, self.diagnostic.hint)))
