"""Faults of the runtime: diagnostics that stop what was asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thorvaldc.diagnostics import CODES, Diagnostic, Span

if TYPE_CHECKING:
    from thorvaldc.model.robot import Robot


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


def require_bus(robot: Robot) -> None:
    """Raises ``RuntimeFault`` (``bus-missing``) for a robot without a bus."""
    if not robot.buses:
        raise RuntimeFault(
            "bus-missing",
            f"{robot.name} has no devices, and so no bus",
            robot.origin,
            hint="give its motors controllers, as the assemblies of the library have",
        )
