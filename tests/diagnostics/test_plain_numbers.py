"""Numbers in messages: no exponents, and whole millimetres are never rounded away."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from thorvaldc.diagnostics import millimetres, plain

ROOT = Path(__file__).resolve().parents[2]
LENGTH = re.compile(r":\.?\d*g\} (?:mm|m)(?![\w/^])")
# Texts of `repr`, and a constant.
OTHERS = ("{self.radius:g} m", "{MAX_EXTENT:g} m")


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (1046.3, 3, "1046"),
        (12.345, 3, "12.3"),
        (650_000.0, 6, "650000"),
        (6_500_000.0, 6, "6500000"),
        (0.000012, 6, "0.000012"),
        (-0.5, 6, "-0.5"),
        (0.0, 6, "0"),
        (1e-4, 6, "0.0001"),
        (1e15, 6, "1e+15"),
    ],
)
def test_plain_numbers(value: float, digits: int, text: str) -> None:
    assert plain(value, digits) == text


def test_millimetres() -> None:
    assert millimetres(1.0463) == "1046 mm"
    assert millimetres(0.65) == "650 mm"
    assert millimetres(0.0123456, 6) == "12.3456 mm"


def test_no_message_formats_a_length_with_an_exponent() -> None:
    for room in ("compiler", "model", "tools/audit", "tools/calibration", "tools/language_server"):
        for path in sorted((ROOT / "thorvaldc" / room).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            for other in OTHERS:
                text = text.replace(other, "")
            assert LENGTH.search(text) is None, path
