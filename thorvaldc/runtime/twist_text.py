"""Twists in text form, for the command line and for messages."""

from __future__ import annotations

from thorvaldc.runtime.se2 import Twist


def parse_twist(text: str) -> Twist:
    """Parses a twist in the form ``vx,vy,wz`` (m/s, m/s, rad/s).

    Raises ``ValueError`` if the text is not three finite numbers.
    """
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 3 and Twist(*numbers).finite:
        return Twist(*numbers)
    raise ValueError(
        f"{text!r} is not a twist of three finite numbers: forward m/s, leftward m/s and turning"
        " rad/s, such as 1,0,0.3"
    )


def twist_text(twist: Twist) -> str:
    """Returns a twist with its units, such as ``(1 m/s, 0 m/s, 0.3 rad/s)``."""
    return f"({twist.vx:.3g} m/s, {twist.vy:.3g} m/s, {twist.wz:.3g} rad/s)"
