"""Quantities: a number with a unit in, a float in SI out.

A unit is kept as an exact fraction times a power of pi, and a number as an
integer times a power of ten, so that ``650 mm`` is the float nearest to 0.65.
"""

from __future__ import annotations

import functools
import math
import re
from typing import NoReturn

from thorvaldc.compiler.source.unit_table import (
    BASE_UNITS,
    COMMON,
    LONG_PREFIXABLE,
    LONG_PREFIXES,
    PLAIN,
    PREFIXABLE,
    PREFIXES,
    QUANTITIES,
    UNITS,
    Dimension,
    Quantity,
    Unit,
)
from thorvaldc.diagnostics.suggest import nearest

__all__ = ["QUANTITIES", "UnitError", "describe", "parse_any", "parse_quantity", "parse_unit"]

_MAX_TEXT = 100
_MAX_EXPONENT = 350
_MAX_POWER = 9


class UnitError(Exception):
    """A text is no quantity, or not of the wanted kind.

    ``message`` is a sentence; ``hint`` says what to do; ``code`` is the name
    of the diagnostic (``bad-quantity`` or ``wrong-dimension``).
    """

    def __init__(self, message: str, hint: str | None = None, code: str = "bad-quantity") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.code = code


@functools.lru_cache(maxsize=4096)  # the numbers of equal modules are the same text
def parse_quantity(text: str, quantity: str) -> float:
    """The value in SI of ``text``, a quantity of the kind ``quantity`` (a key of QUANTITIES).

    Text without a unit is a number in SI.  Raises UnitError.
    """
    wanted = QUANTITIES[quantity]
    value, unit = _parse(text, wanted)
    if unit is None or unit.dimension in wanted.dimensions:
        return value
    raise UnitError(
        f"`{_shorten(text)}` is {describe(unit.dimension)}; {wanted} is wanted",
        f"give it as in `{wanted.example}`",
        "wrong-dimension",
    )


def parse_any(text: str) -> float:
    """The value in SI of a quantity of any kind.  Raises UnitError."""
    return _parse(text, None)[0]


def parse_unit(text: str) -> Unit:
    """A unit by itself, such as ``kg m^2``.  Raises UnitError."""
    return _parse_unit(text)


def describe(dimension: Dimension) -> str:
    """A dimension in words: ``a length``, or its base units where it has no name."""
    for quantity in QUANTITIES.values():
        if dimension == quantity.dimensions[0]:
            return str(quantity)
    powers = [(base, power) for base, power in zip(BASE_UNITS, dimension, strict=True) if power]
    return "in " + " ".join(base if power == 1 else f"{base}^{power}" for base, power in powers)


# -- numbers --------------------------------------------------------------------

_NUMBER = re.compile(r"([+-]?)(?:(\d+)(?:\.(\d*))?|\.(\d+))(?:[eE]([+-]?\d+))?(?![\w.])", re.ASCII)
_NUMBER_BEFORE_UNIT = re.compile(
    r"([+-]?)(?:(\d+)(?:\.(\d*))?|\.(\d+))(?:[eE]([+-]?\d+))?", re.ASCII
)
_BROKEN_NUMBER = re.compile(r"(?!1\s*/)[,._']?\d")


def _parse(text: str, wanted: Quantity | None) -> tuple[float, Unit | None]:
    """Value in SI and unit (``None``: a plain number, which fits every quantity)."""
    shown = _shorten(text)
    example = f"write a number with a unit, as in `{wanted.example if wanted else '650 mm'}`"
    if len(text) > _MAX_TEXT:
        raise UnitError(f"`{shown}` is too long for a quantity", example)
    stripped = text.strip().replace("\N{MINUS SIGN}", "-")
    number = _NUMBER_BEFORE_UNIT.match(stripped)
    if number is None:
        if not stripped:
            raise UnitError("the text is empty; a quantity is wanted", example)
        raise UnitError(f"`{shown}` is not a quantity: it does not begin with a number", example)
    rest = stripped[number.end() :].strip()
    mantissa, exponent = _mantissa(number, shown)
    if not rest:
        return _value(mantissa, exponent, PLAIN, shown), None
    if rest[0] == ":":
        return _ratio(mantissa, exponent, rest[1:].strip(), shown), PLAIN
    if rest[0] == "/":
        rest = "1" + rest  # `1/s`
    elif _BROKEN_NUMBER.match(rest):
        raise UnitError(
            f"`{shown}` is not a quantity: the number is broken after `{number[0]}`",
            "write digits together and the decimal point as `.`, as in `1500.5 mm`",
        )
    unit = _parse_unit(rest)
    return _value(mantissa, exponent, unit, shown), unit


def _mantissa(number: re.Match[str], shown: str) -> tuple[int, int]:
    """A decimal number as (mantissa, exponent of ten)."""
    sign, whole, fraction, only_fraction, power = number.groups()
    decimals = fraction or only_fraction or ""
    mantissa = int((whole or "") + decimals or "0")
    exponent = int(power or 0) if len(power or "") < 9 else 10**9
    exponent -= len(decimals)
    if mantissa and abs(exponent) > _MAX_EXPONENT:
        raise UnitError(f"the number in `{shown}` is out of range", "use a larger or smaller unit")
    return (-mantissa if sign == "-" else mantissa), exponent if mantissa else 0


def _value(mantissa: int, exponent: int, unit: Unit, shown: str) -> float:
    top = mantissa * unit.numerator
    bottom = unit.denominator
    if exponent >= 0:
        top *= 10**exponent
    else:
        bottom *= 10**-exponent
    try:
        value: float
        if unit.pi_power:
            # As math.radians does: the factor is rounded once, then the product.
            plain = mantissa * 10**exponent if exponent >= 0 else mantissa / 10**-exponent
            value = plain * (unit.numerator * math.pi**unit.pi_power / unit.denominator)
        elif unit.offset:
            value = (top * 100 + unit.offset * bottom) / (bottom * 100)
        else:
            value = top / bottom
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise UnitError(f"the number in `{shown}` is out of range", "use a larger or smaller unit")
    return value


def _ratio(mantissa: int, exponent: int, rest: str, shown: str) -> float:
    number = _NUMBER.fullmatch(rest)
    if number is None:
        raise UnitError(f"`{shown}` is not a ratio", "write a ratio as in `42:1`")
    below, below_exponent = _mantissa(number, shown)
    if below == 0:
        raise UnitError(f"the ratio `{shown}` divides by zero", "write a ratio as in `42:1`")
    sign = -1 if below < 0 else 1
    power = exponent - below_exponent
    if abs(power) > _MAX_EXPONENT:
        raise UnitError(f"the ratio `{shown}` is out of range", "write a ratio as in `42:1`")
    return _value(sign * mantissa, power, Unit(PLAIN.dimension, 1, abs(below)), shown)


def _shorten(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


# -- units ------------------------------------------------------------------------

UNIT_NAME = r"(?:[^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|°[CF]?|%|\"|'|″|′)"
"""What a unit's name looks like, without its power."""

UNIT_POWER = r"(?:\^\s*[+-]?\d+|[⁺⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+|\d+)"
"""``^2``, ``²`` or a digit after a unit's name."""

_TOKEN = re.compile(rf"\s*(?:({UNIT_NAME})({UNIT_POWER})?|([*·⋅×/()])|(1)(?=\s*/))")
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻", "0123456789+-")


@functools.lru_cache(maxsize=1024)
def _parse_unit(text: str) -> Unit:
    """``kg m^2``, ``N s/m``, ``m/s²``, ``J/(kg K)``: products and quotients from left to right."""
    whole = _lookup(text)
    if whole is not None:
        return whole
    unit, end = _parse_product(text, 0, 0)
    if end != len(text):
        _refuse(text, text[end:])
    return unit


def _parse_product(text: str, position: int, depth: int) -> tuple[Unit, int]:
    result: Unit | None = None
    sign = 1
    pending = False  # an operator waits for its right-hand side
    while True:
        token = _TOKEN.match(text, position)
        if token is None:
            break
        name, power, symbol, one = token.groups()
        if symbol == ")":
            break
        if symbol == "(":
            if depth >= 4:
                _refuse(text, text)
            factor, position = _parse_product(text, token.end(), depth + 1)
            closing = _TOKEN.match(text, position)
            if closing is None or closing[3] != ")":
                _refuse(text, text)
            position = closing.end()
        elif symbol is not None:
            if pending or result is None:
                _refuse(text, symbol)
            pending, sign = True, -1 if symbol == "/" else 1
            position = token.end()
            continue
        elif one is not None:
            factor, position = PLAIN, token.end()
        else:
            if name == "per" and result is not None and not pending and power is None:
                pending, sign, position = True, -1, token.end()
                continue
            factor = _power(_named(name, text), power, text)
            position = token.end()
        result = _times(result, factor, sign, text) if result is not None else factor
        pending, sign = False, 1
    if result is None or pending:
        _refuse(text, text[position:] or text)
    return result, position


def _named(name: str, text: str) -> Unit:
    unit = _lookup(name)
    if unit is None:
        _refuse(text, name)
    return unit


def _lookup(name: str) -> Unit | None:
    unit = UNITS.get(name)
    if unit is not None:
        return unit
    for length in (1, 2):
        prefix, stem = name[:length], name[length:]
        if prefix in PREFIXES and stem in PREFIXABLE:
            return _scaled(UNITS[stem], PREFIXES[prefix])
    for prefix, power in LONG_PREFIXES.items():
        if name.startswith(prefix) and name[len(prefix) :] in LONG_PREFIXABLE:
            return _scaled(UNITS[name[len(prefix) :]], power)
    return None


def _scaled(unit: Unit, power: int) -> Unit:
    up, down = (10**power, 1) if power >= 0 else (1, 10**-power)
    return Unit(unit.dimension, unit.numerator * up, unit.denominator * down, unit.pi_power)


def _power(unit: Unit, power: str | None, text: str) -> Unit:
    if power is None:
        return unit
    digits = power.translate(_SUPERSCRIPT).lstrip("^").strip()
    exponent = int(digits) if len(digits) < 4 else 999
    if unit.offset or abs(exponent) > _MAX_POWER:
        _refuse(text, text)
    up, down = unit.numerator, unit.denominator
    if exponent < 0:
        up, down = down, up
    return Unit(
        tuple(d * exponent for d in unit.dimension),
        up ** abs(exponent),
        down ** abs(exponent),
        unit.pi_power * exponent,
    )


def _times(a: Unit, b: Unit, sign: int, text: str) -> Unit:
    if a.offset or b.offset or max(map(abs, (*a.dimension, *b.dimension))) > 4 * _MAX_POWER:
        _refuse(text, text)
    up, down = (b.numerator, b.denominator) if sign > 0 else (b.denominator, b.numerator)
    return Unit(
        tuple(x + sign * y for x, y in zip(a.dimension, b.dimension, strict=True)),
        a.numerator * up,
        a.denominator * down,
        a.pi_power + sign * b.pi_power,
    )


def _refuse(text: str, part: str) -> NoReturn:
    part = part.strip()
    if part and part != text.strip() and re.fullmatch(UNIT_NAME, part) is None:
        raise UnitError(
            f"`{_shorten(text)}` is not a unit: it cannot be read at `{_shorten(part)}`",
            "write units as in `N m`, `m/s^2` or `kg m^2`",
        )
    raise UnitError(f"there is no unit `{_shorten(part or text)}`", _unit_hint(part or text))


_JOINED = re.compile(r"(kg|g|kN|mN|N)(m|mm|cm|s|ms)")  # `kgm^2`: two units written as one


def _unit_hint(name: str) -> str:
    for known in COMMON:
        if known.casefold() == name.casefold():
            return f"did you mean `{known}`?"
    joined = _JOINED.fullmatch(name)
    if joined:
        return f"put a space between units: `{joined[1]} {joined[2]}`"
    found = nearest(name, COMMON)
    if found is not None:
        return f"did you mean `{found}`?"
    return "write units as in `mm`, `kg`, `deg`, `rpm`, `N m` or `m/s^2`"
