"""Parses and evaluates the expressions of module documents: ``${length / 2 - 20 mm}``.

The compiler does not use Python's own parser for the expressions of module documents.  The numbers
in an expression have units, error messages contain a position, and an expression must not execute
Python code.  The length and the nesting depth of an expression are limited, so that parsing is
always fast.  The parser converts an expression to a tree of closures from the module
``expression_operations``.

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
import re
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.compiler.source import expression_dimensions as dimensions
from thorvaldc.compiler.source import expression_operations as operations
from thorvaldc.compiler.source.expression_dimensions import Dimensions, Infer
from thorvaldc.compiler.source.expression_operations import Evaluate
from thorvaldc.compiler.source.expression_tokens import (
    END,
    KEYWORDS,
    ExpressionError,
    Token,
    syntax_error,
    tokenize,
)
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics.suggest import did_you_mean

__all__ = [
    "ExpressionError",
    "evaluate",
    "evaluate_text",
    "expression_of",
    "infer_dimension",
    "split_text",
]

MAX_LENGTH = 1000
MAX_DEPTH = 40


def expression_of(node: Node) -> str | None:
    """Returns the text between ``${`` and ``}``, or ``None`` if a YAML node is no expression."""
    value = node.value
    is_expression = isinstance(value, str) and value.startswith("${") and value.endswith("}")
    return str(value)[2:-1] if is_expression else None


def evaluate(text: str, scope: Mapping[str, Any]) -> Any:
    """Returns the value of an expression in SI units.

    - ``text``: the expression, which a document contains between ``${`` and ``}``.
    - ``scope``: value of each known name.  The value of a name is a number in SI units, a truth
      value, a text, a list or a mapping.  The expression ``a.key`` reads the key ``key`` of the
      mapping ``a``.

    A name is looked up in ``scope`` only when the expression needs its value.  The mapping
    ``scope`` can therefore compute a value when it is read.  If ``scope`` raises ``KeyError``, the
    name is unknown.  Raises ``ExpressionError`` if the expression has a syntax error, an unknown
    name or no value.  Other exceptions that ``scope`` raises are not caught.
    """
    return _compile(text)[0](scope)


def infer_dimension(text: str, scope: Dimensions) -> Any:
    """Returns the dimension of an expression, as ``expression_dimensions`` describes it.

    - ``text``: the expression, which a document contains between ``${`` and ``}``.

    Raises ``DimensionError`` if parts of the expression have dimensions that do not fit.
    """
    return _compile(text)[1](scope)


def evaluate_text(text: str, scope: Mapping[str, Any]) -> Any:
    """Evaluates the ``${...}`` expressions in a text of a module document.

    If the whole text is a single ``${...}`` expression, returns the value of the expression.  If
    the text contains more than one expression, or text outside expressions, returns the text with
    each expression replaced by its value.  The attribute ``offset`` of an ``ExpressionError`` is
    the position of the error in ``text``.
    """
    parts = split_text(text)
    if not any(is_expression for _, _, is_expression in parts):
        return text
    results: list[Any] = []
    for part, offset, is_expression in parts:
        if not is_expression:
            results.append(part)
            continue
        try:
            results.append(evaluate(part, scope))
        except ExpressionError as error:
            error.offset += offset
            raise
    if len(results) == 1:
        return results[0]
    return "".join(operations.show(result, bare=True) for result in results)


@functools.lru_cache(maxsize=4096)
def split_text(text: str) -> tuple[tuple[str, int, bool], ...]:
    """Splits a text into its ``${...}`` expressions and the text between the expressions.

    Returns a tuple (part, offset, is_expression) for each expression and each text between
    expressions.  For an expression, ``part`` is the text between ``${`` and ``}``.  The field
    ``offset`` is the position of the part in the whole text.  Raises ``ExpressionError`` if the
    closing brace of an expression is missing.
    """
    parts: list[tuple[str, int, bool]] = []
    position = 0
    while (start := text.find("${", position)) >= 0:
        if start > position:
            parts.append((text[position:start], position, False))
        inside = _INSIDE.match(text, start + 2)
        if inside is None:
            raise syntax_error("`${` without a closing `}`", start, "add the `}`")
        parts.append((inside[1], start + 2, True))
        position = inside.end()
    if position < len(text) or not parts:
        parts.append((text[position:], position, False))
    return tuple(parts)


# Regular expression for the text of an expression and its closing brace.  A text in quotes inside
# an expression can contain a brace.
_INSIDE = re.compile(r"((?:[^}'\"]|'[^']*'|\"[^\"]*\"|['\"](?=[^'\"]*\}))*)\}")


# -- parser -------------------------------------------------------------------------

# Precedence levels of the binary operators, beginning with the lowest precedence.  Each precedence
# level is a tuple (symbols of the operators, name of the function that combines the operands).
_LEVELS = (
    (("==", "!=", "<", "<=", ">", ">="), "compare"),
    (("+", "-"), "chain"),
    (("*", "/", "%"), "chain"),
)


@functools.lru_cache(maxsize=4096)
def _compile(text: str) -> tuple[Evaluate, Infer]:
    if len(text) > MAX_LENGTH:
        raise syntax_error(f"the expression is longer than {MAX_LENGTH} characters", 0)
    if text.isidentifier() and text.isascii() and text not in KEYWORDS:
        # Most expressions of modules are a name, which needs no parser.
        return operations.look_up_name(text, 0), dimensions.look_up_name(text, 0)
    tokens = tokenize(text)
    return _Parser(tokens, operations).expression(), _Parser(tokens, dimensions).expression()


class _Parser:
    """A recursive-descent parser.

    Each method of the parser parses one rule of the grammar, and returns a closure that computes
    its value or its dimension.

    - ``algebra``: the module that makes the closures, ``expression_operations`` for values or
      ``expression_dimensions`` for dimensions.
    """

    def __init__(self, tokens: list[Token], algebra: Any) -> None:
        self.tokens = tokens
        self.algebra = algebra
        self.position = 0
        self.depth = 0

    @property
    def token(self) -> Token:
        return self.tokens[self.position]

    def expression(self) -> Any:
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

    def choice(self) -> Any:
        self.descend(self.token.offset)
        value = self.either()
        if_token = self.take("if")
        if if_token is not None:
            condition = self.either()
            self.expect("else")
            value = self.algebra.choose(condition, value, self.choice(), if_token.offset)
        self.depth -= 1
        return value

    def either(self) -> Any:
        return self.logical("or", True, self.both)

    def both(self) -> Any:
        return self.logical("and", False, self.negation)

    def logical(self, word: str, decisive: bool, operand: Callable[[], Any]) -> Any:
        operands = [operand()]
        offset = self.token.offset
        while self.take(word):
            operands.append(operand())
        if len(operands) == 1:
            return operands[0]
        return self.algebra.logical(word, decisive, operands, offset)

    def negation(self) -> Any:
        offset = self.token.offset
        count = 0
        while self.take("not"):
            count += 1
        value = self.operators(0)
        return self.algebra.negate(value, count, offset) if count else value

    def operators(self, level: int) -> Any:
        """Parses binary operators (grammar rules ``comparison``, ``sum``, ``product``).

        - ``level``: index of the rule in ``_LEVELS``.
        """
        if level == len(_LEVELS):
            return self.unary()
        symbols, combine = _LEVELS[level]
        first = self.operators(level + 1)
        rest: list[tuple[str, Any, int]] = []
        while self.token.kind == "operator" and self.token.text in symbols:
            token = self.token
            self.position += 1
            rest.append((token.text, self.operators(level + 1), token.offset))
        return getattr(self.algebra, combine)(first, rest) if rest else first

    def unary(self) -> Any:
        offset = self.token.offset
        count = minus = 0
        while self.token.kind == "operator" and self.token.text in "+-":
            count += 1
            minus += self.token.text == "-"
            self.position += 1
        value = self.power()
        return self.algebra.signed(value, minus % 2 == 1, offset) if count else value

    def power(self) -> Any:
        value = self.postfix()
        token = self.take("**")
        if token is None:
            return value
        self.descend(token.offset)
        value = self.algebra.chain(value, [("**", self.unary(), token.offset)])
        self.depth -= 1
        return value

    def postfix(self) -> Any:
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
                value = self.algebra.attribute(value, name.text, name.offset)
            elif self.take("["):
                index = self.choice()
                self.expect("]")
                value = self.algebra.element(value, index, token.offset)
            else:
                return value

    def atom(self) -> Any:
        token = self.token
        self.position += 1
        if token.kind in ("number", "text"):
            return self.algebra.constant(token)
        if token.kind == "name":
            if self.take("("):
                return self.call(token)
            return self.algebra.look_up_name(token.text, token.offset)
        if token.kind == "operator" and token.text == "(":
            value = self.choice()
            self.expect(")")
            return value
        if token.kind == "operator" and token.text == "[":
            return self.algebra.list_of(self.elements("]"))
        self.position -= 1
        if token.kind == END:
            raise syntax_error("expected a value, but the expression ends", token.offset)
        raise syntax_error(f"expected a value, got `{token.text}`", token.offset)

    def elements(self, closing: str) -> list[Any]:
        """Parses a comma-separated list of expressions up to the bracket ``closing``."""
        elements: list[Any] = []
        while not self.take(closing):
            if elements:
                self.expect(",")
                if self.take(closing):
                    break
            elements.append(self.choice())
        return elements

    def call(self, token: Token) -> Any:
        functions = operations.FUNCTIONS
        if token.text not in functions:
            hint = did_you_mean(token.text, functions, "the functions are " + " ".join(functions))
            message = f"unknown function `{token.text}`"
            raise ExpressionError(message, token.offset, hint=hint, code="expression-name")
        arguments = self.elements(")")
        _, count = functions[token.text]
        if (count and len(arguments) != count) or not arguments:
            expected = {0: "at least 1 value", 1: "1 value"}.get(count, f"{count} values")
            message = f"`{token.text}` takes {expected}, not {len(arguments)}"
            raise syntax_error(message, token.offset)
        return self.algebra.call(token.text, arguments, token.offset)
