"""Parser of twists in text form, for the command line and for services."""

from __future__ import annotations

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.runtime.se2 import Twist


def parse_twist(text: str) -> Twist:
    """Parses a twist in the form ``vx,vy,wz`` (m/s, m/s, rad/s).

    Raises ``DiagnosticError`` (``twist-invalid``) if the text is not three finite numbers.
    """
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 3 and Twist(*numbers).finite:
        return Twist(*numbers)
    raise DiagnosticError(
        "twist-invalid",
        f"`{text}` is not a twist of three finite numbers",
        hint="give forward m/s, leftward m/s and turning rad/s, such as 1,0,0.3",
    )
