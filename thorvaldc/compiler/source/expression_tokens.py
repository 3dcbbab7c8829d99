"""The words of an expression: numbers with their units, names, text, operators."""

from __future__ import annotations

import re
from typing import Any

from thorvaldc.compiler.source.units import UNIT_NAME, UNIT_POWER, UnitError, parse_any, parse_unit


class ExpressionError(Exception):
    """An expression cannot be read or has no value.

    ``offset`` counts characters from the beginning of the expression; ``code``
    is the name of the diagnostic: ``expression-syntax``, ``expression-name``
    or ``expression-value``.
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


_WORD = r"[A-Za-z_][A-Za-z0-9_]*"
_KEYWORDS = ("and", "or", "not", "if", "else")
_NOT_KEYWORD = rf"(?!(?:{'|'.join(_KEYWORDS)})\b)"
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
END = "end"


class Token:
    __slots__ = ("divisors", "kind", "offset", "text", "value")

    def __init__(self, kind: str, text: str, offset: int, value: Any = None) -> None:
        self.kind = kind  # number, name, text, operator, keyword, end
        self.text = text
        self.offset = offset
        self.value = value
        self.divisors: tuple[str, ...] = ()  # names after a `/` that were read as units


def tokenize(text: str) -> list[Token]:
    tokens: list[Token] = []
    position = 0
    stripped = text.rstrip()
    while position < len(stripped):
        found = _TOKENS.match(stripped, position)
        if found is None:
            at = position + len(stripped[position:]) - len(stripped[position:].lstrip())
            character = stripped[at]
            hint = {
                "=": "a comparison is `==`",
                "^": "a power is `**`",
                ":": "write a ratio as a number: `42`, not `42:1`",
                "&": "write `and`",
                "|": "write `or`",
                "!": "write `not`",
                "'": "close the text with the quote it began with",
                '"': "close the text with the quote it began with",
            }.get(character)
            raise syntax_error(f"`{character}` cannot stand here", at, hint)
        position = found.end()
        kind = found.lastgroup or ""
        if found["number"] is not None:
            position = _number(found, stripped, tokens)
        elif kind == "hexadecimal":
            digits, offset = found["hexadecimal"], found.start("hexadecimal")
            tokens.append(Token("number", digits, offset, int(digits, 16)))
        elif kind == "word":
            word, offset = found["word"], found.start("word")
            tokens.append(Token("keyword" if word in _KEYWORDS else "name", word, offset))
        elif kind == "text":
            tokens.append(Token("text", found["text"], found.start("text"), found["text"][1:-1]))
        else:
            tokens.append(Token("operator", found["operator"], found.start("operator")))
    tokens.append(Token(END, "", len(stripped)))
    return tokens


def _number(found: re.Match[str], text: str, tokens: list[Token]) -> int:
    """Append a number with its unit, where one follows; the position after it."""
    literal, offset, end = found["number"], found.start("number"), found.end()
    unit = found["unit"]
    if unit is None:
        digits = literal
    else:
        digits = literal[: len(literal) - len(unit)]
        # What follows `/` may be a name and no unit: `20 mm / count`.
        while not _is_unit(unit) and (cut := _LAST_FACTOR.search(unit, 1)):
            unit = unit[: cut.start()]
        literal, end = digits + unit, offset + len(digits) + len(unit)
    value: Any
    if unit is None and digits.isdigit():
        if len(digits) > 18:
            raise syntax_error("the number is too large", offset)
        value = int(digits)
    else:
        try:
            value = parse_any(literal)
        except UnitError as error:
            raise ExpressionError(
                error.message, offset, hint=error.hint, code="expression-syntax"
            ) from None
    if unit is not None and text[end:].lstrip().startswith("**"):
        raise syntax_error(
            f"`{literal} **` can be read in two ways",
            offset,
            f"write `({literal}) ** 2`, or the power of the unit as `mm^2`",
        )
    tokens.append(Token("number", literal, offset, value))
    if unit is not None and "/" in unit:
        tokens[-1].divisors = tuple(re.findall(rf"/\s*({_WORD})(?=[\s/·⋅]|$)", unit))
    return end


_LAST_FACTOR = re.compile(r"(?:\s*/\s*|\s*[·⋅]\s*|\s+)[^\s/·⋅]+$")


def _is_unit(unit: str) -> bool:
    try:
        parse_unit(unit.strip())
    except UnitError:
        return False
    return True


def syntax_error(message: str, offset: int, hint: str | None = None) -> ExpressionError:
    return ExpressionError(message, offset, hint=hint, code="expression-syntax")
