"""Parses the expressions of module documents: ``${length / 2 - 20 mm}``.

The compiler does not use Python's own parser for the expressions of module documents.  The numbers
in an expression have units, error messages contain a position, and an expression must not execute
Python code.  The length and the nesting depth of an expression are limited, so that parsing is
always fast.

The parser converts an expression to a tree of closures, which is independent of what the expression
computes: each closure passes its operands to a method of an ``Algebra``.  ``expressions`` has the
algebra of values, ``dimensions`` that of physical dimensions.

Grammar of an expression, from the operator that binds weakest to the operator that binds strongest
(``?``: optional part, ``*``: repeated part):

    choice     = either ("if" either "else" choice)?
    either     = both ("or" both)*
    both       = negation ("and" negation)*
    negation   = "not"* comparison
    comparison = sum (("==" | "!=" | "<" | "<=" | ">" | ">=") sum)*
    sum        = product (("+" | "-") product)*
    product    = unary (("*" | "/" | "%") unary)*
    unary      = ("+" | "-")* power
    power      = postfix ("**" unary)?
    postfix    = atom ("." name | "[" choice "]")*
    atom       = number | text | name | name "(" list ")" | "(" choice ")" | "[" list "]"
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from thorvaldc.compiler.source import units
from thorvaldc.compiler.source.unit_table import Dimension
from thorvaldc.diagnostics import did_you_mean

MAX_LENGTH = 1000
MAX_DEPTH = 40

# Functions of the expression language: name -> (Python function, number of arguments).  The number
# of arguments is 0 for a function that takes one or more arguments.
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "min": (lambda *values: min(values), 0),
    "max": (lambda *values: max(values), 0),
    "abs": (abs, 1),
    "sqrt": (math.sqrt, 1),
    "hypot": (math.hypot, 0),
    "sin": (math.sin, 1),
    "cos": (math.cos, 1),
    "tan": (math.tan, 1),
    "asin": (math.asin, 1),
    "acos": (math.acos, 1),
    "atan": (math.atan, 1),
    "atan2": (math.atan2, 2),
    "floor": (math.floor, 1),
    "ceil": (math.ceil, 1),
    "len": (len, 1),
}


class Algebra(Protocol):
    """What the names, operators and functions of expressions compute: values or dimensions.

    The parameter ``offset`` is the position of an operator or name in the expression, for error
    messages.  The operands of ``choose`` and ``logical`` are parts of the expression, because not
    all of them need a value.
    """

    def constant(self, token: Token) -> Any: ...

    def name(self, name: str, offset: int) -> Any: ...

    def attribute(self, operand: Any, name: str, offset: int) -> Any: ...

    def element(self, operand: Any, index: Any, offset: int) -> Any: ...

    def choose(self, condition: Part, value: Part, otherwise: Part, offset: int) -> Any: ...

    def logical(self, word: str, decisive: bool, operands: list[Part], offset: int) -> Any:
        """Computes a chain of ``and`` or ``or``.

        - ``word``: name of the operator.
        - ``decisive``: operand that decides the result: false for ``and``, true for ``or``.
        """

    def negate(self, operand: Any, is_odd: bool, offset: int) -> Any:
        """Computes ``not``, or an even number of them."""

    def compare(self, symbol: str, left: Any, right: Any, offset: int) -> Any:
        """Computes a comparison.  The result ``False`` ends a chain such as ``a < b <= c``."""

    def signed(self, operand: Any, minus: bool, offset: int) -> Any: ...

    def combine(self, symbol: str, left: Any, right: Any, offset: int) -> Any:
        """Computes an arithmetic operator, such as ``left + right``."""

    def call(self, name: str, arguments: list[Any], offset: int) -> Any: ...


Part = Callable[[Algebra], Any]
"""A part of an expression, which computes its value or its dimension."""


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
_UNIT = rf"{_NOT_KEYWORD}(?!%|\"|')(?:{units.UNIT_NAME})(?:{units.UNIT_POWER})?"
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
_LAST_FACTOR = r"(?:\s*/\s*|\s*[·⋅]\s*|\s+)[^\s/·⋅]+$"
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


class Token(NamedTuple):
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
        while not _is_unit(unit) and (factor := re.compile(_LAST_FACTOR).search(unit, 1)):
            unit = unit[: factor.start()]
        literal = digits + unit
        if "/" in unit:
            divisors = tuple(re.findall(rf"/\s*({_WORD})(?=[\s/·⋅]|$)", unit))
    try:
        value, dimension = units.parse_with_dimension(literal)
    except units.UnitError as error:
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
        units.parse_unit(unit.strip())
    except units.UnitError:
        return False
    return True


# -- parser -------------------------------------------------------------------------

# Symbols of the binary operators, beginning with the lowest precedence.
_LEVELS = (("==", "!=", "<", "<=", ">", ">="), ("+", "-"), ("*", "/", "%"))


@functools.lru_cache(maxsize=4096)
def parse(text: str) -> Part:
    """Parses an expression, which a document contains between ``${`` and ``}``.

    Raises ``ExpressionError`` if the expression has a syntax error.
    """
    if len(text) > MAX_LENGTH:
        raise syntax_error(f"the expression is longer than {MAX_LENGTH} characters", 0)
    if text.isidentifier() and text.isascii() and text not in KEYWORDS:
        # Most expressions of modules are a name, which needs no parser.
        return lambda algebra: algebra.name(text, 0)
    return _Parser(tokenize(text)).expression()


class _Parser:
    """A recursive-descent parser.

    Each method parses one rule of the grammar.
    """

    def __init__(self, tokens: list[Token]) -> None:
        self.tokens = tokens
        self.position = 0
        self.depth = 0

    @property
    def token(self) -> Token:
        return self.tokens[self.position]

    def expression(self) -> Part:
        result = self.choice()
        if self.token.kind != END:
            raise syntax_error(f"unexpected `{self.token.text}`", self.token.offset)
        return result

    def take(self, text: str) -> Token | None:
        """Advances to the following token if the next token is the operator or keyword ``text``.

        Returns the token, or ``None`` if the next token is not the operator or keyword ``text``.
        """
        token = self.token
        if token.kind in ("operator", "keyword") and token.text == text:
            self.position += 1
            return token
        return None

    def expect(self, text: str) -> None:
        if self.take(text) is None:
            token = self.token
            actual = f"got `{token.text}`" if token.kind != END else "but the expression ends"
            raise syntax_error(f"expected `{text}`, {actual}", token.offset)

    def descend(self, offset: int) -> None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise syntax_error("the expression is nested too deeply", offset)

    def choice(self) -> Part:
        self.descend(self.token.offset)
        value = self.either()
        if_token = self.take("if")
        if if_token is not None:
            condition = self.either()
            self.expect("else")
            value = _choice(condition, value, self.choice(), if_token.offset)
        self.depth -= 1
        return value

    def either(self) -> Part:
        return self.logical("or", True, self.both)

    def both(self) -> Part:
        return self.logical("and", False, self.negation)

    def logical(self, word: str, decisive: bool, operand: Callable[[], Part]) -> Part:
        operands = [operand()]
        offset = self.token.offset
        while self.take(word):
            operands.append(operand())
        if len(operands) == 1:
            return operands[0]
        return lambda algebra: algebra.logical(word, decisive, operands, offset)

    def negation(self) -> Part:
        offset = self.token.offset
        count = 0
        while self.take("not"):
            count += 1
        value = self.operators(0)
        if not count:
            return value
        return lambda algebra: algebra.negate(value(algebra), count % 2 == 1, offset)

    def operators(self, level: int) -> Part:
        """Parses binary operators (grammar rules ``comparison``, ``sum``, ``product``).

        - ``level``: index of the rule in ``_LEVELS``.
        """
        if level == len(_LEVELS):
            return self.unary()
        first = self.operators(level + 1)
        rest: list[tuple[str, Part, int]] = []
        while self.token.kind == "operator" and self.token.text in _LEVELS[level]:
            token = self.token
            self.position += 1
            rest.append((token.text, self.operators(level + 1), token.offset))
        if not rest:
            return first
        return _comparisons(first, rest) if level == 0 else _chain(first, rest)

    def unary(self) -> Part:
        offset = self.token.offset
        count = minus = 0
        while self.token.kind == "operator" and self.token.text in "+-":
            count += 1
            minus += self.token.text == "-"
            self.position += 1
        value = self.power()
        if not count:
            return value
        return lambda algebra: algebra.signed(value(algebra), minus % 2 == 1, offset)

    def power(self) -> Part:
        value = self.postfix()
        token = self.take("**")
        if token is None:
            return value
        self.descend(token.offset)
        value = _chain(value, [("**", self.unary(), token.offset)])
        self.depth -= 1
        return value

    def postfix(self) -> Part:
        value = self.atom()
        count = 0
        while True:
            token = self.token
            count += 1
            if count > MAX_DEPTH:
                raise syntax_error("the expression is nested too deeply", token.offset)
            if self.take("."):
                name = self.token
                if name.kind != "name":
                    raise syntax_error("expected a name after `.`", name.offset)
                self.position += 1
                value = _attribute(value, name)
            elif self.take("["):
                index = self.choice()
                self.expect("]")
                value = _element(value, index, token.offset)
            else:
                return value

    def atom(self) -> Part:
        token = self.token
        self.position += 1
        if token.kind in ("number", "text"):
            return lambda algebra: algebra.constant(token)
        if token.kind == "name":
            if self.take("("):
                return self.call(token)
            return lambda algebra: algebra.name(token.text, token.offset)
        if token.kind == "operator" and token.text == "(":
            value = self.choice()
            self.expect(")")
            return value
        if token.kind == "operator" and token.text == "[":
            elements = self.elements("]")
            return lambda algebra: [element(algebra) for element in elements]
        self.position -= 1
        if token.kind == END:
            raise syntax_error("expected a value, but the expression ends", token.offset)
        raise syntax_error(f"expected a value, got `{token.text}`", token.offset)

    def elements(self, closing: str) -> list[Part]:
        """Parses a comma-separated list of expressions up to the bracket ``closing``."""
        elements: list[Part] = []
        while not self.take(closing):
            if elements:
                self.expect(",")
                if self.take(closing):
                    break
            elements.append(self.choice())
        return elements

    def call(self, token: Token) -> Part:
        name = token.text
        if name not in FUNCTIONS:
            hint = did_you_mean(name, FUNCTIONS, "the functions are " + " ".join(FUNCTIONS))
            message = f"unknown function `{name}`"
            raise ExpressionError(message, token.offset, hint=hint, code="expression-name")
        arguments = self.elements(")")
        _, count = FUNCTIONS[name]
        if (count and len(arguments) != count) or not arguments:
            expected = {0: "at least 1 value", 1: "1 value"}.get(count, f"{count} values")
            message = f"`{name}` takes {expected}, not {len(arguments)}"
            raise syntax_error(message, token.offset)
        return lambda algebra: algebra.call(name, [a(algebra) for a in arguments], token.offset)


# Closures for parts whose operands are parts that the parser replaces afterwards.


def _choice(condition: Part, value: Part, otherwise: Part, offset: int) -> Part:
    return lambda algebra: algebra.choose(condition, value, otherwise, offset)


def _attribute(operand: Part, name: Token) -> Part:
    return lambda algebra: algebra.attribute(operand(algebra), name.text, name.offset)


def _element(operand: Part, index: Part, offset: int) -> Part:
    return lambda algebra: algebra.element(operand(algebra), index(algebra), offset)


def _comparisons(first: Part, rest: list[tuple[str, Part, int]]) -> Part:
    """Returns a chain of comparisons, such as ``a < b <= c``."""

    def run(algebra: Algebra) -> Any:
        left, result = first(algebra), None
        for symbol, operand, offset in rest:
            right = operand(algebra)
            result = algebra.compare(symbol, left, right, offset)
            if result is False:
                break
            left = right
        return result

    return run


def _chain(first: Part, rest: list[tuple[str, Part, int]]) -> Part:
    """Returns a chain of arithmetic operators of equal precedence, applied from left to right."""

    def run(algebra: Algebra) -> Any:
        value = first(algebra)
        for symbol, operand, offset in rest:
            value = algebra.combine(symbol, value, operand(algebra), offset)
        return value

    return run
