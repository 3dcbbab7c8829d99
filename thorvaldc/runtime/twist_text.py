"""Parser of twists in text form, for the command line."""

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
