"""Converts numbers with units, such as ``650 mm``, to floats in SI units.

The conversion factor of a unit to SI is an exact fraction times a power of pi.  The number before
the unit is an integer times a power of ten.  If the unit does not contain pi, the value in SI units
is therefore a quotient of two integers.  For example, 1.5 cm = (15 * 10**-1) * (1 / 100) m = 15 /
1000 m.  Python divides two integers with a single rounding, so ``650 mm`` gives the float nearest
to 0.65.  A product of two floats, such as 650.0 * 0.001, would be rounded more than once.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterable
from typing import NoReturn

from thorvaldc.compiler.source import unit_table
from thorvaldc.compiler.source.unit_table import PLAIN, Dimension, Quantity, Unit
from thorvaldc.diagnostics import Proposal, nearest

_MAX_TEXT = 100
_MAX_EXPONENT = 350
_MAX_POWER = 9


class UnitError(Exception):
    """Raised if a text is not a quantity of the expected kind, such as a length.

    - ``message``: message of the diagnostic.
    - ``hint``: hint of the diagnostic.
    - ``code``: name of the diagnostic, ``bad-quantity`` or ``wrong-dimension``.
    - ``unknown``: the unknown unit, if there is one.
    """

    def __init__(
        self,
        message: str,
        hint: str | None = None,
        code: str = "bad-quantity",
        unknown: str = "",
    ) -> None:
        super().__init__(message)
        self.unknown = unknown
        self.message = message
        self.hint = hint
        self.code = code


# Results are cached, because a robot has several modules of one type with the same quantities.
@functools.lru_cache(maxsize=4096)
def parse_quantity(text: str, quantity: str) -> float:
    """Returns the value of a quantity in SI units.

    - ``text``: a number with a unit.  A number without a unit counts as a value in SI units.
    - ``quantity``: expected kind of quantity, a key of ``QUANTITIES``.

    Raises ``UnitError`` if the text is not a quantity of the expected kind.
    """
    kind = unit_table.QUANTITIES[quantity]
    value, unit = _parse(text, kind)
    if unit is None or unit.dimension in kind.dimensions:
        return value
    raise UnitError(
        f"`{_shorten(text)}` is {describe(unit.dimension)}; expected {kind}",
        _same_meaning(text, value, unit, kind) or _in_unit_of(kind, text),
        "wrong-dimension",
    )


def parse_any(text: str) -> float:
    """Returns the value of a quantity in SI units, with any physical dimension.

    Raises ``UnitError`` if the text is not a quantity.
    """
    return _parse(text, None)[0]


def parse_with_dimension(text: str) -> tuple[float, Dimension | None]:
    """Returns the value of a quantity in SI units and the dimension of its unit.

    The dimension is ``None`` if the number has no unit.  Raises ``UnitError`` if the text is not a
    quantity.
    """
    value, unit = _parse(text, None)
    return value, unit.dimension if unit is not None else None


def is_bare_number(text: str) -> bool:
    """Returns whether a text is a number without a unit, such as ``700``."""
    return _NUMBER.fullmatch(text.strip().replace("\N{MINUS SIGN}", "-")) is not None


def describe(dimension: Dimension) -> str:
    """Returns the name of a physical dimension, such as ``a length``.

    If the physical dimension has no name, returns its base units, such as ``in m kg``.
    """
    for quantity in unit_table.QUANTITIES.values():
        if dimension == quantity.dimensions[0]:
            return str(quantity)
    powers = [
        (base, power) for base, power in zip(unit_table.BASE_UNITS, dimension, strict=True) if power
    ]
    return "in " + " ".join(base if power == 1 else f"{base}^{power}" for base, power in powers)


# -- numbers --------------------------------------------------------------------

_NUMBER = re.compile(r"([+-]?)(?:(\d+)(?:\.(\d*))?|\.(\d+))(?:[eE]([+-]?\d+))?(?![\w.])", re.ASCII)
_NUMBER_BEFORE_UNIT = re.compile(
    r"([+-]?)(?:(\d+)(?:\.(\d*))?|\.(\d+))(?:[eE]([+-]?\d+))?", re.ASCII
)
_QUOTIENT = re.compile(r"/\s*(\d+(?:\.\d*)?)\s*([^\d/].*)?")
_RATIO_IN_WORDS = re.compile(r"to\s*(\d+(?:\.\d+)?)")
# Patterns that only an error needs are texts: ``re`` compiles them at their first use.
_SEPARATED = r"([+-]?\d+)([,._' ])(\d+)(?![,._'\d])(.*)"
_OTHER_BRACES = r"\$\{([^{}]+)|\{\{([^{}]+)\}\}|\$([a-z_]\w*)"  # of other tools
_SECOND_NUMBER = re.compile(r"(?!1\s*/)[,._']?\d")


def _parse(text: str, kind: Quantity | None) -> tuple[float, Unit | None]:
    """Returns the SI value and the unit of a quantity.

    If the number has no unit, the returned unit is ``None``.  A number without a unit is allowed
    for every kind of quantity.
    """
    shown = _shorten(text)
    example_value = kind.example if kind else "650 mm"
    example: str = f"write a number with a unit, as in `{example_value}`"
    if not re.search(r"\d", text):
        example = Proposal(example, example_value, is_example=True)
    if len(text) > _MAX_TEXT:
        raise UnitError(f"`{shown}` is too long for a quantity", example)
    stripped = text.strip().replace("\N{MINUS SIGN}", "-")
    number = _NUMBER_BEFORE_UNIT.match(stripped)
    if number is None:
        if not stripped:
            raise UnitError("the text is empty; expected a quantity", example)
        braces = re.fullmatch(_OTHER_BRACES, stripped)
        if braces is not None:
            text = f'"${{{(braces[1] or braces[2] or braces[3]).strip()}}}"'
            raise UnitError(
                f"`{shown}` is not an expression", Proposal(f"write an expression as {text}", text)
            )
        raise UnitError(f"`{shown}` is not a quantity: it does not begin with a number", example)
    rest = stripped[number.end() :].strip().replace("''", '"')  # inches
    mantissa, exponent = _mantissa(number, shown)
    if not rest:
        return _value(mantissa, exponent, PLAIN, shown), None
    if rest[0] == ":":
        return _ratio(mantissa, exponent, rest[1:].strip(), shown), PLAIN
    if rest[0] == "/":
        quotient = _QUOTIENT.fullmatch(rest)
        if quotient is not None:
            raise UnitError(
                f"`{shown}` is a quotient of two numbers", _quotient_hint(number[0], quotient, kind)
            )
        rest = "1" + rest  # `1/s`
    elif _SECOND_NUMBER.match(rest):
        raise UnitError(
            f"`{shown}` is not a quantity: the number is interrupted after `{number[0]}`",
            _separator_hint(stripped),
        )
    elif (words := _RATIO_IN_WORDS.fullmatch(rest)) and (kind is None or kind.unit == "1"):
        ratio = f"{number[0]}:{words[1]}"
        raise UnitError(f"`{shown}` is not a ratio", Proposal(f"write a ratio as `{ratio}`", ratio))
    unit = _parse_unit_after_number(rest, text, kind)
    return _value(mantissa, exponent, unit, shown), unit


def _parse_unit_after_number(rest: str, text: str, kind: Quantity | None) -> Unit:
    """Parses the unit ``rest`` of the quantity ``text``.

    For an unknown unit, the hint contains the whole quantity with a similar unit of the expected
    kind.
    """
    try:
        return parse_unit(rest)
    except UnitError as error:
        hint = error.hint
        if kind is not None and error.unknown == rest:
            hint = _unit_hint(rest, kind) or _in_unit_of(kind, text)
        if isinstance(hint, Proposal) and hint.word:
            hint = hint.within(text)
        raise UnitError(error.message, hint, error.code) from None


def _same_meaning(text: str, value: float, unit: Unit, kind: Quantity) -> Proposal | None:
    """Returns the hint for a quantity that people state in another form, or ``None``.

    A period means a frequency, and a frequency a period; a share is the grade of a slope.
    """
    if {describe(unit.dimension), str(kind)} == {"a time", "a frequency"} and value > 0.0:
        same = f"{1.0 / value:.6g} {kind.unit}"
    elif "%" in text and str(kind) == "an angle" and value > 0.0:
        same = f"{math.degrees(math.atan(value)):.6g} deg"
    else:
        return None
    return Proposal(f"write `{same}` if that is meant", same)


def _in_unit_of(kind: Quantity, text: str) -> str:
    """Returns the hint to write the number of ``text`` in a unit of the expected kind.

    The number is that of the user: nobody notices an example that replaces it.
    """
    number = _NUMBER_BEFORE_UNIT.match(text.strip())
    if number is None or ":" in text:
        return f"write {kind} as in `{kind.example}`"
    unit = kind.example.partition(" ")[2]
    if unit == "mm" and "." in number[0]:
        unit = "m"  # people write 1.2 m and 1200 mm
    quantity = f"{number[0]} {unit}".strip()
    return Proposal(f"write {kind} as in `{quantity}`", quantity, is_example=True)


def _quotient_hint(number: str, quotient: re.Match[str], kind: Quantity | None) -> str:
    """Returns the hint for a quantity such as ``42/1`` or ``1/2 m``."""
    divisor, unit = quotient.groups()
    if not unit and (kind is None or kind.unit == "1"):
        return Proposal(f"write a ratio as in `{number}:{divisor}`", f"{number}:{divisor}")
    if float(divisor) == 0.0:
        return "write one number and a unit"
    decimal = f"{float(number) / float(divisor):.12g} {unit or ''}".strip()
    return Proposal(f"write one number, as in `{decimal}`", decimal)


def _separator_hint(text: str) -> str:
    """Returns the hint for a number with separators, such as ``10,5 deg`` or ``1_500 mm``."""
    hint = "write digits without separators and `.` as decimal point"
    separated = re.fullmatch(_SEPARATED, text)
    if separated is None:
        return f"{hint}, as in `1500.5 mm`"
    whole, separator, decimals, unit = separated.groups()
    decimal, joined = f"{whole}.{decimals}{unit}", f"{whole}{decimals}{unit}"
    if separator != ",":
        return Proposal(f"{hint}: `{joined}`", joined)
    if len(decimals) != 3:
        return Proposal(f"{hint}: `{decimal}`", decimal)
    return Proposal(f"{hint}: `{decimal}` or `{joined}`", decimal, joined)


def _mantissa(number: re.Match[str], shown: str) -> tuple[int, int]:
    """Returns a number as two integers (mantissa, exponent): mantissa * 10**exponent."""
    sign, whole, fraction, only_fraction, power = number.groups()
    decimals = fraction or only_fraction or ""
    mantissa = int((whole or "") + decimals or "0")
    exponent = int(power or 0) if len(power or "") < 9 else 10**9
    exponent -= len(decimals)
    if mantissa and abs(exponent) > _MAX_EXPONENT:
        raise UnitError(f"the number in `{shown}` is out of range", "use a larger or smaller unit")
    return (-mantissa if sign == "-" else mantissa), exponent if mantissa else 0


def _value(mantissa: int, exponent: int, unit: Unit, shown: str) -> float:
    """Converts the number mantissa * 10**exponent from the unit ``unit`` to SI units.

    The value in SI units is rounded only once, except for units that contain pi.
    """
    numerator = mantissa * unit.numerator
    denominator = unit.denominator
    if exponent >= 0:
        numerator *= 10**exponent
    else:
        denominator *= 10**-exponent
    try:
        value: float
        if unit.pi_power:
            # The conversion factor with pi is rounded first, as in `math.radians`.
            plain = mantissa * 10**exponent if exponent >= 0 else mantissa / 10**-exponent
            value = plain * (unit.numerator * math.pi**unit.pi_power / unit.denominator)
        elif unit.offset:
            value = (numerator * 100 + unit.offset * denominator) / (denominator * 100)
        else:
            value = numerator / denominator
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise UnitError(f"the number in `{shown}` is out of range", "use a larger or smaller unit")
    return value


def _ratio(mantissa: int, exponent: int, rest: str, shown: str) -> float:
    number = _NUMBER.fullmatch(rest)
    if number is None:
        raise UnitError(f"`{shown}` is not a ratio", "write a ratio as in `42:1`")
    divisor, divisor_exponent = _mantissa(number, shown)
    if divisor == 0:
        raise UnitError(f"the ratio `{shown}` divides by zero", "write a ratio as in `42:1`")
    sign = -1 if divisor < 0 else 1
    power = exponent - divisor_exponent
    if abs(power) > _MAX_EXPONENT:
        raise UnitError(f"the ratio `{shown}` is out of range", "write a ratio as in `42:1`")
    return _value(sign * mantissa, power, Unit(PLAIN.dimension, 1, abs(divisor)), shown)


def _shorten(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


# -- units ------------------------------------------------------------------------

UNIT_NAME = r"(?:[^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|°[CF]?|%|\"|'|″|′)"
"""Regular expression of a unit name, without a power."""

UNIT_POWER = r"(?:\^\s*[+-]?\d+|[⁺⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+|\d+)"
"""Regular expression of the power of a unit, such as ``^2``, ``²`` or ``2``."""

_TOKEN = re.compile(rf"\s*(?:({UNIT_NAME})({UNIT_POWER})?|([*·⋅×/()])|(1)(?=\s*/))")
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻", "0123456789+-")


@functools.lru_cache(maxsize=1024)
def parse_unit(text: str) -> Unit:
    """Parses a unit such as ``kg m^2``, ``N s/m``, ``m/s²`` or ``J/(kg K)``.

    The operators ``*`` and ``/`` in a unit are applied from left to right.  Raises ``UnitError`` if
    the text is not a unit.
    """
    known_unit = _find_unit(text)
    if known_unit is not None:
        return known_unit
    unit, end = _parse_product(text, 0, 0)
    if end != len(text):
        _raise_error(text, text[end:])
    return unit


def _parse_product(text: str, position: int, depth: int) -> tuple[Unit, int]:
    """Parses a product of units, such as ``kg m^2``, up to a closing parenthesis or the end.

    - ``position``: position in the text at which parsing starts.
    - ``depth``: number of parentheses that are open at this position.

    Returns the parsed unit and the position at which parsing ended.
    """
    result: Unit | None = None
    sign = 1
    pending = False  # after an operator, before its right operand
    while True:
        token = _TOKEN.match(text, position)
        if token is None:
            break
        name, power, symbol, unity = token.groups()
        if name == "per" and result is not None and not pending and power is None:
            symbol = "/"
        if symbol == ")":
            break
        if symbol == "(":
            if depth >= 4:
                _raise_error(text, text)
            factor, position = _parse_product(text, token.end(), depth + 1)
            closing = _TOKEN.match(text, position)
            if closing is None or closing[3] != ")":
                _raise_error(text, text)
            position = closing.end()
        elif symbol is not None:
            if pending or result is None:
                _raise_error(text, symbol)
            pending, sign = True, -1 if symbol == "/" else 1
            position = token.end()
            continue
        elif unity is not None:
            factor, position = PLAIN, token.end()
        else:
            factor = _raise_to_power(_find_unit_or_raise(name, text), power, text)
            position = token.end()
        result = _multiply(result, factor, sign, text) if result is not None else factor
        pending, sign = False, 1
    if result is None or pending:
        _raise_error(text, text[position:] or text)
    return result, position


def _find_unit_or_raise(name: str, text: str) -> Unit:
    unit = _find_unit(name)
    if unit is None:
        _raise_error(text, name)
    return unit


def _find_unit(name: str) -> Unit | None:
    unit = unit_table.UNITS.get(name)
    if unit is not None:
        return unit
    for length in (1, 2):
        prefix, stem = name[:length], name[length:]
        power = unit_table.PREFIXES.get(prefix)
        if power is None or stem not in unit_table.PREFIXABLE:
            continue
        if power <= 3 or stem not in unit_table.NEVER_MILLIONS:
            return _scale(unit_table.UNITS[stem], power)
    for prefix, power in unit_table.LONG_PREFIXES.items():
        if name.startswith(prefix) and name[len(prefix) :] in unit_table.LONG_PREFIXABLE:
            return _scale(unit_table.UNITS[name[len(prefix) :]], power)
    return None


def _scale(unit: Unit, power: int) -> Unit:
    """Returns a unit that is larger than ``unit`` by the factor 10**power."""
    numerator, denominator = unit.numerator, unit.denominator
    if power >= 0:
        numerator *= 10**power
    else:
        denominator *= 10**-power
    return Unit(unit.dimension, numerator, denominator, unit.pi_power)


def _raise_to_power(unit: Unit, power: str | None, text: str) -> Unit:
    if power is None:
        return unit
    digits = power.translate(_SUPERSCRIPT).lstrip("^").strip()
    exponent = int(digits) if len(digits) < 4 else 999
    if unit.offset or abs(exponent) > _MAX_POWER:
        _raise_error(text, text)
    numerator, denominator = unit.numerator, unit.denominator
    if exponent < 0:
        numerator, denominator = denominator, numerator
    return Unit(
        tuple(d * exponent for d in unit.dimension),
        numerator ** abs(exponent),
        denominator ** abs(exponent),
        unit.pi_power * exponent,
    )


def _multiply(a: Unit, b: Unit, sign: int, text: str) -> Unit:
    """Returns the unit ``a * b`` if ``sign`` is 1, or the unit ``a / b`` if ``sign`` is -1."""
    if a.offset or b.offset or max(map(abs, (*a.dimension, *b.dimension))) > 4 * _MAX_POWER:
        _raise_error(text, text)
    numerator, denominator = b.numerator, b.denominator
    if sign < 0:
        numerator, denominator = denominator, numerator
    return Unit(
        tuple(x + sign * y for x, y in zip(a.dimension, b.dimension, strict=True)),
        a.numerator * numerator,
        a.denominator * denominator,
        a.pi_power + sign * b.pi_power,
    )


def _raise_error(text: str, part: str) -> NoReturn:
    """Raises ``UnitError`` if the unit is invalid.

    - ``text``: text of the whole unit, such as ``kg m^2``.
    - ``part``: part of the text that is not a valid unit.
    """
    part = part.strip()
    if part and part != text.strip() and re.fullmatch(UNIT_NAME, part) is None:
        raise UnitError(
            f"`{_shorten(text)}` is not a unit: `{_shorten(part)}` is not valid there",
            "write units as in `N m`, `m/s^2` or `kg m^2`",
        )
    name = part or text
    raise UnitError(f"unknown unit `{_shorten(name)}`", _unit_hint(name), unknown=name)


_JOINED = r"(kg|g|kN|mN|N)(m|mm|cm|s|ms)"  # such as `kgm^2` without a space


def _one_letter_off(name: str, units: Iterable[str]) -> str | None:
    """Returns the first unit with the length and the first letter of ``name`` that differs from
    ``name`` in one letter.
    """
    for unit in units:
        if len(unit) == len(name) > 1 and unit[0] == name[0]:
            differences = [a for a, b in zip(unit, name, strict=True) if a != b]
            if len(differences) == 1:
                return unit
    return None


def _unit_hint(name: str, kind: Quantity | None = None) -> str | None:
    """Returns the hint for an unknown unit.

    - ``kind``: expected kind of quantity.  The hint proposes only units of this kind.  Without a
      similar one, the hint is ``None``.
    """
    common: Iterable[str] = unit_table.COMMON
    if kind is not None:
        common = [
            kind.unit,
            *(u for u in unit_table.COMMON if parse_unit(u).dimension in kind.dimensions),
        ]
    for known in common:
        if known.casefold() == name.casefold():
            return Proposal(f"did you mean `{known}`?", known, word=name)
    joined = re.fullmatch(_JOINED, name)
    if joined:
        spaced = f"{joined[1]} {joined[2]}"
        return Proposal(f"put a space between units: `{spaced}`", spaced, word=name)
    if (
        kind is not None
        and name in unit_table.PREFIXES
        and kind.unit.partition("/")[0] in unit_table.PREFIXABLE
    ):
        return Proposal(f"did you mean `{name}{kind.unit}`?", name + kind.unit, word=name)
    similar = _one_letter_off(name, common) if kind is not None else None
    similar = similar or nearest(name, common)
    if similar is not None:
        return Proposal(f"did you mean `{similar}`?", similar, word=name)
    if kind is not None:
        return None
    return "write units as in `mm`, `kg`, `deg`, `rpm`, `N m` or `m/s^2`"
