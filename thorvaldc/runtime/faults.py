"""Faults of the runtime: diagnostics that stop what was asked for."""

from __future__ import annotations

from thorvaldc.diagnostics import CODES, Diagnostic, Span


class RuntimeFault(Exception):
    """Something cannot be run; ``diagnostic`` says what, and what to do.

    Raised where there is no report at hand; whoever has one adds the
    diagnostic to it.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic(CODES[code], message, span, hint)


class NotFiniteError(ValueError):
    """A twist or a joint state holds a NaN or an infinity; nothing was changed."""


class ParameterError(ValueError):
    """A parameter cannot have that value; nothing was changed."""
