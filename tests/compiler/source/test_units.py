"""Tests of quantities: exact values in SI, and errors with hints."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_quantity
from thorvaldc.diagnostics import Proposal


@pytest.mark.parametrize(
    ("text", "quantity", "value"),
    [
        ("650 mm", "length", 0.65),
        ("650mm", "length", 0.65),
        ("0.1 mm", "length", 0.0001),
        ("1e3 um", "length", 0.001),
        ("5 µm", "length", 5e-6),
        ("5 μm", "length", 5e-6),
        ("1 in", "length", 0.0254),
        ('10"', "length", 0.254),
        ("32''", "length", 0.8128),
        ("2 ft", "length", 0.6096),
        ("1.2", "length", 1.2),
        ("−5 cm", "length", -0.05),
        ("3 centimetres", "length", 0.03),
        ("500 g", "mass", 0.5),
        ("0.5 N m s", "rotational_damping", 0.5),
        ("2 t", "mass", 2000.0),
        ("15 deg", "angle", math.radians(15)),
        ("-176.4 deg", "angle", math.radians(-176.4)),
        ("15°", "angle", math.radians(15)),
        ("0.5 turn", "angle", math.pi),
        ("100 ms", "time", 0.1),
        ("1.5 m/s", "velocity", 1.5),
        ("3.6 km/h", "velocity", 1.0),
        ("3 metres per second", "velocity", 3.0),
        ("1.5 m/s^2", "acceleration", 1.5),
        ("1.5 m/s²", "acceleration", 1.5),
        ("1.5 m s⁻²", "acceleration", 1.5),
        ("90 deg/s", "angular_velocity", math.pi / 2),
        ("90 N m", "torque", 90.0),
        ("90 N·m", "torque", 90.0),
        ("90 Nm", "torque", 90.0),
        ("90 N*m", "torque", 90.0),
        ("900 mN m", "torque", 0.9),
        ("1e-4 kg m^2", "inertia", 1e-4),
        ("2 kg m2", "inertia", 2.0),
        ("100 g cm^2", "inertia", 1e-5),
        ("20 kN/m", "stiffness", 20000.0),
        ("900 N s/m", "damping", 900.0),
        ("300 N m/rad", "rotational_stiffness", 300.0),
        ("300 N m", "rotational_stiffness", 300.0),
        ("0.5 N m s/rad", "rotational_damping", 0.5),
        ("42:1", "ratio", 42.0),
        ("1:42", "ratio", 1 / 42),
        ("50 %", "ratio", 0.5),
        ("42", "ratio", 42.0),
        ("12:30", "ratio", 0.4),
        ("50 Hz", "frequency", 50.0),
        ("2 1/s", "frequency", 2.0),
        ("48 V", "voltage", 48.0),
        ("70 Ah", "charge", 252000.0),
        ("3.36 kWh", "energy", 12096000.0),
        ("500 W", "power", 500.0),
        ("2700 kg/m^3", "density", 2700.0),
        ("500 kbit/s", "bitrate", 500000.0),
        ("1 Mbit/s", "bitrate", 1e6),
        ("20 °C", "temperature", 293.15),
        ("8 byte", "data", 64.0),
        ("460 J/(kg K)", None, 460.0),
    ],
)
def test_values(text: str, quantity: str | None, value: float) -> None:
    assert (parse_quantity(text, quantity) if quantity else parse_any(text)) == value


def test_rpm() -> None:
    assert parse_quantity("3000 rpm", "angular_velocity") == pytest.approx(100 * math.pi, rel=1e-15)


@given(st.integers(-(10**9), 10**9), st.integers(0, 6))
def test_decimal_units_round_once(digits: int, decimals: int) -> None:
    text = f"{digits / 10**decimals:.{decimals}f}"
    assert parse_quantity(f"{text} mm", "length") == float(f"{text}e-3")
    assert parse_quantity(f"{text} deg", "angle") == math.radians(float(text))


@pytest.mark.parametrize("name", QUANTITIES)
def test_every_quantity_has_an_example_and_a_unit_that_parse(name: str) -> None:
    quantity = QUANTITIES[name]
    assert parse_quantity(quantity.example, name) > 0
    assert parse_quantity(f"1 {quantity.unit}" if quantity.unit != "1" else "1", name) == 1.0


@pytest.mark.parametrize(
    ("text", "quantity", "message"),
    [
        ("5 kg", "length", "`5 kg` is a mass; expected a length"),
        ("5 m", "mass", "`5 m` is a length; expected a mass"),
        ("50 Hz", "angular_velocity", "is a frequency; expected an angular velocity"),
        ("90 rpm", "frequency", "is an angular velocity; expected a frequency"),
        ("42:1", "length", "is a ratio; expected a length"),
        ("5 kg m", "length", "is in m kg; expected a length"),
    ],
)
def test_wrong_dimensions_are_named(text: str, quantity: str, message: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse_quantity(text, quantity)
    assert message in caught.value.message
    assert caught.value.code == "wrong-dimension"
    hint = caught.value.hint
    if isinstance(hint, Proposal):  # the fix keeps the number of the user
        assert hint.replacements[0].split(" ")[0] == text.split(" ")[0]
        assert hint.is_example
        parse_quantity(hint.replacements[0], quantity)
    else:
        assert QUANTITIES[quantity].example in str(hint)
    assert isinstance(hint, Proposal) == (":" not in text)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("5 MM", "did you mean `mm`?"),
        ("1.4 Mm", "did you mean `mm`?"),  # 1400 km
        ("5 Mg", "did you mean `mg`?"),
        ("5 Ms", "did you mean `ms`?"),
        ("5 Kg", "did you mean `kg`?"),
        ("5 hz", "did you mean `Hz`?"),
        ("5 milimetre", "did you mean `millimetre`?"),
        ("5 kgm^2", "put a space between units: `kg m`"),
        ("1,5 m", "`.` as decimal point"),
        ("1 000 m", "write digits without separators"),
        ("1_000 m", "write digits without separators"),
    ],
)
def test_hints(text: str, hint: str) -> None:
    with pytest.raises(UnitError) as caught:
        parse_any(text)
    assert hint in str(caught.value.hint)
    assert caught.value.code == "bad-quantity"


@pytest.mark.parametrize(
    "text",
    [
        *("", " ", "m", "mm 5", "inf m", "nan", ".inf", "1e", "5 m/", "5 m//s", "5 (m", "5 m)"),
        *("5 /", "5 m^", "5 m^99", "5 m^-", "5:0", "1:", ":1", "1:2:3", "1:2 mm", "5 degC/s"),
        *("1e400 m", "1e-400 m", "1e999999999999 m", "1e300 km km", "0x2A", "5 m m m m m (((((m"),
        *("9" * 500, "5 " + "m " * 500, "٣ m", "5 ^2", "5 *", "--5 m", "5 m^1e9"),
    ],
)
def test_refused(text: str) -> None:
    with pytest.raises(UnitError):
        parse_quantity(text, "length")


@given(st.text(max_size=30), st.sampled_from(list(QUANTITIES)))
def test_any_text_is_a_finite_number_or_an_error(text: str, quantity: str) -> None:
    for shown in (text, f"5 {text}", f"5 m{text}", f"{text} mm"):
        with contextlib.suppress(UnitError):
            assert math.isfinite(parse_quantity(shown, quantity))
