"""Tokenizer for the expressions of module documents.

A token of an expression is a number with or without a unit, a name, a text in quotes, a keyword or
an operator.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from thorvaldc.compiler.source.unit_table import Dimension
from thorvaldc.compiler.source.units import (
    UNIT_NAME,
    UNIT_POWER,
    UnitError,
    parse_unit,
    parse_with_dimension,
)


class ExpressionError(Exception):
    """Raised if an expression has a syntax error, or if its value cannot be computed.

    - ``offset``: position of the error in the expression, in characters from 0.
    - ``hint``: hint of the diagnostic.
    - ``code``: name of the diagnostic, which is ``expression-syntax``, ``expression-name`` or
      ``expression-value``.
    """

    def __init__(
        self,
        message: str,
        offset: int = 0,
        *,
        hint: str | None = None,
        code: str = "expression-value",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.offset = offset
        self.hint = hint
        self.code = code


def syntax_error(message: str, offset: int, hint: str | None = None) -> ExpressionError:
    return ExpressionError(message, offset, hint=hint, code="expression-syntax")


_WORD = r"[A-Za-z_][A-Za-z0-9_]*"
KEYWORDS = ("and", "or", "not", "if", "else")
_NOT_KEYWORD = rf"(?!(?:{'|'.join(KEYWORDS)})\b)"
# A number token includes all units that follow the number: `20 N m / s` is one token.  A name
# before `(`, `.` or `[` is a function or a variable and never a unit.  For example, `min` in the
# expression `60 s/min(2, 3)` is a function and not the unit minute.  The keywords of the expression
# language, such as `and`, are never read as units.  Outside expressions, `%` is the unit percent,
# and a quote is the unit inch or foot.  Inside expressions, `%` is the remainder operator, and a
# quote starts a text.
_UNIT = rf"{_NOT_KEYWORD}(?!%|\"|')(?:{UNIT_NAME})(?:{UNIT_POWER})?"
_TOKENS = re.compile(
    rf"""\s*(?:
        (?P<hexadecimal>0x[0-9A-Fa-f]{{1,15}}\b)
        | (?P<number>(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?
            (?P<unit>\s*{_UNIT}(?:(?:\s*/\s*|\s*[·⋅]\s*|[ ]+){_UNIT}(?![A-Za-z_]|\s*[(.\[]))*)?)
        | (?P<word>{_WORD})
        | (?P<text>'[^']*'|"[^"]*")
        | (?P<operator>\*\*|==|!=|<=|>=|[-+*/%<>()\[\],.])
    )""",
    re.VERBOSE,
)
_LAST_FACTOR = re.compile(r"(?:\s*/\s*|\s*[·⋅]\s*|\s+)[^\s/·⋅]+$")
_HINTS = {
    "=": "a comparison is `==`",
    "^": "a power is `**`",
    ":": "write a ratio as a number: `42`, not `42:1`",
    "&": "write `and`",
    "|": "write `or`",
    "!": "write `not`",
    "'": "close the text with the same quote",
    '"': "close the text with the same quote",
}
END = "end"


@dataclass(slots=True)
class Token:
    """A token of an expression, such as a number, a name or an operator.

    - ``kind``: kind of the token, which is number, name, text, operator, keyword or end.
    - ``text``: source text of the token.
    - ``offset``: position of the token in the expression, in characters from 0.
    - ``value``: number in SI, or the content of a text without its quotes.
    - ``divisors``: unit names that follow a ``/`` in a number token.  A divisor such as ``m`` in
      ``20 / m`` is ambiguous if it is a unit and also a known name.
    - ``dimension``: dimension of the unit of a number token, or ``None`` without a unit.
    """

    kind: str
    text: str
    offset: int
    value: Any = None
    divisors: tuple[str, ...] = ()
    dimension: Dimension | None = None


def tokenize(text: str) -> list[Token]:
    """Returns the tokens of an expression, with an end token of the kind ``END``.

    Raises ``ExpressionError`` if the expression has a syntax error.
    """
    tokens: list[Token] = []
    text = text.rstrip()
    position = 0
    while position < len(text):
        match = _TOKENS.match(text, position)
        if match is None:
            offset = len(text) - len(text[position:].lstrip())
            character = text[offset]
            raise syntax_error(f"unexpected `{character}`", offset, _HINTS.get(character))
        token = _make_token(match)
        tokens.append(token)
        position = token.offset + len(token.text)
    tokens.append(Token(END, "", len(text)))
    return tokens


def _make_token(match: re.Match[str]) -> Token:
    if match["number"] is not None:
        return _make_number(match)
    kind = match.lastgroup or ""
    text, offset = match[kind], match.start(kind)
    if kind == "hexadecimal":
        return Token("number", text, offset, int(text, 16))
    if kind == "word":
        return Token("keyword" if text in KEYWORDS else "name", text, offset)
    return Token(kind, text, offset, text[1:-1] if kind == "text" else None)


def _make_number(match: re.Match[str]) -> Token:
    """Returns the token for a number with or without a unit in an expression."""
    literal, unit, offset = match["number"], match["unit"], match.start("number")
    value: Any
    if unit is None and literal.isdigit():
        if len(literal) > 18:
            raise syntax_error("the number is too large", offset)
        return Token("number", literal, offset, int(literal))
    divisors: tuple[str, ...] = ()
    if unit is not None:
        digits = literal.removesuffix(unit)
        # The last factors after a number may be names of values instead of units, such as `count`
        # in the expression `20 mm / count`.
        while not _is_unit(unit) and (factor := _LAST_FACTOR.search(unit, 1)):
            unit = unit[: factor.start()]
        literal = digits + unit
        divisors = tuple(re.findall(rf"/\s*({_WORD})(?=[\s/·⋅]|$)", unit))
    try:
        value, dimension = parse_with_dimension(literal)
    except UnitError as error:
        raise syntax_error(error.message, offset, error.hint) from None
    if unit is not None and match.string[offset + len(literal) :].lstrip().startswith("**"):
        raise syntax_error(
            f"`{literal} **` is ambiguous",
            offset,
            f"write `({literal}) ** 2`, or the power of the unit as `mm^2`",
        )
    return Token("number", literal, offset, value, divisors, dimension)


def _is_unit(unit: str) -> bool:
    try:
        parse_unit(unit.strip())
    except UnitError:
        return False
    return True
