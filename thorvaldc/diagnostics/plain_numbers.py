"""Numbers in messages and tables, without exponents: nobody measures 1.05e+03 mm."""

from __future__ import annotations


def plain(value: float, digits: int = 6) -> str:
    """Returns a number with ``digits`` significant digits and no exponent, such as ``1046``.

    The digits before the decimal point are not rounded.  A number that no robot has, from 1e15 on
    or below 1e-12, keeps its exponent.
    """
    text = f"{value:.{digits}g}"
    if "e" not in text or not 1e-12 < abs(value) < 1e15:
        return text
    if abs(value) >= 1.0:
        return f"{value:.0f}"
    return f"{value:.15f}".rstrip("0").rstrip(".")


def millimetres(length: float, digits: int = 3) -> str:
    """Returns a length, given in m, in mm with its unit, such as ``1046 mm``."""
    return f"{plain(1000.0 * length, digits)} mm"
