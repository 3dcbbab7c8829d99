"""Expressions of module documents: ``${length / 2 - 20 mm}``.

A parser and evaluator of our own, so that a document cannot run code, literals
may carry units, and faults have a place.  Text is compiled once to closures.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.compiler.source import expression_values as values
from thorvaldc.compiler.source.expression_tokens import (
    END,
    ExpressionError,
    Token,
    syntax_error,
    tokenize,
)
from thorvaldc.compiler.source.expression_values import Evaluate
from thorvaldc.diagnostics.suggest import did_you_mean

__all__ = ["ExpressionError", "evaluate", "evaluate_text", "split_text"]

MAX_LENGTH = 1000
MAX_DEPTH = 40


def evaluate(text: str, scope: Mapping[str, Any]) -> Any:
    """The value, in SI, of an expression (what stands between ``${`` and ``}``).

    ``scope`` holds numbers in SI, truth values, text, lists, or mappings that
    are read by attribute; a name is looked up when it is needed, so ``scope``
    may compute on access.  Raises ExpressionError (and what ``scope`` raises,
    except KeyError, which means an unknown name).
    """
    return _compile(text)(scope)


def evaluate_text(text: str, scope: Mapping[str, Any]) -> Any:
    """The value of a scalar: of the expression if it is one as a whole, else
    text with the values of its expressions put in.  Offsets count in ``text``.
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
    return "".join(values.shown(result, plain=True) for result in results)


@functools.lru_cache(maxsize=4096)
def split_text(text: str) -> tuple[tuple[str, int, bool], ...]:
    """Text as (part, offset, whether it is the inside of a ``${...}``).  Raises ExpressionError."""
    parts: list[tuple[str, int, bool]] = []
    position = 0
    while (start := text.find("${", position)) >= 0:
        if start > position:
            parts.append((text[position:start], position, False))
        inside = _INSIDE.match(text, start + 2)
        if inside is None:
            raise ExpressionError(
                "`${` without a closing `}`", start, hint="close it", code="expression-syntax"
            )
        parts.append((inside[1], start + 2, True))
        position = inside.end()
    if position < len(text) or not parts:
        parts.append((text[position:], position, False))
    return tuple(parts)


# Text in quotes may hold a brace.
_INSIDE = re.compile(r"((?:[^}'\"]|'[^']*'|\"[^\"]*\"|['\"](?=[^'\"]*\}))*)\}")


# -- parser -------------------------------------------------------------------------

_COMPARISONS = ("==", "!=", "<", "<=", ">", ">=")
_PRECEDENCE = {"+": 5, "-": 5, "*": 6, "/": 6, "%": 6}


@functools.lru_cache(maxsize=4096)
def _compile(text: str) -> Evaluate:
    if len(text) > MAX_LENGTH:
        raise syntax_error(f"the expression is longer than {MAX_LENGTH} characters", 0)
    parser = _Parser(tokenize(text))
    result = parser.choice()
    token = parser.token
    if token.kind != END:
        raise syntax_error(f"`{token.text}` cannot stand here", token.offset)
    return result


class _Parser:
    """Recursive descent with precedence climbing; each method returns a closure."""

    def __init__(self, tokens: list[Token]) -> None:
        self.tokens = tokens
        self.position = 0
        self.depth = 0

    @property
    def token(self) -> Token:
        return self.tokens[self.position]

    def take(self, text: str) -> Token | None:
        token = self.token
        if token.kind in ("operator", "keyword") and token.text == text:
            self.position += 1
            return token
        return None

    def expect(self, text: str) -> None:
        if self.take(text) is None:
            token = self.token
            found = f"not `{token.text}`" if token.kind != END else "and the expression ends"
            raise syntax_error(f"`{text}` is wanted here, {found}", token.offset)

    def choice(self) -> Evaluate:
        """``a if c else b``"""
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise syntax_error("the expression is nested too deeply", self.token.offset)
        value = self.either()
        mark = self.take("if")
        if mark is not None:
            condition = self.either()
            self.expect("else")
            value = values.choose(condition, value, self.choice(), mark.offset)
        self.depth -= 1
        return value

    def either(self) -> Evaluate:
        return self.logical("or", True, lambda: self.logical("and", False, self.negation))

    def logical(self, word: str, decisive: bool, operand: Callable[[], Evaluate]) -> Evaluate:
        first = operand()
        rest: list[Evaluate] = []
        offset = self.token.offset
        while self.take(word):
            rest.append(operand())
        return values.logical(word, decisive, [first, *rest], offset) if rest else first

    def negation(self) -> Evaluate:
        offset = self.token.offset
        count = 0
        while self.take("not"):
            count += 1
        value = self.comparison()
        return values.negate(value, count % 2 == 1, offset) if count else value

    def comparison(self) -> Evaluate:
        first = self.arithmetic(5)
        rest: list[tuple[str, Evaluate, int]] = []
        while self.token.kind == "operator" and self.token.text in _COMPARISONS:
            mark = self.token
            self.position += 1
            rest.append((mark.text, self.arithmetic(5), mark.offset))
        return values.compare(first, rest) if rest else first

    def arithmetic(self, least: int) -> Evaluate:
        first = self.unary()
        rest: list[tuple[str, Evaluate, int]] = []
        while self.token.kind == "operator":
            mark = self.token
            precedence = _PRECEDENCE.get(mark.text, 0)
            if precedence < least:
                break
            self.position += 1
            rest.append((mark.text, self.arithmetic(precedence + 1), mark.offset))
        return values.chain(first, rest) if rest else first

    def unary(self) -> Evaluate:
        offset = self.token.offset
        count = minus = 0
        while self.token.kind == "operator" and self.token.text in "+-":
            count += 1
            minus += self.token.text == "-"
            self.position += 1
        value = self.power()
        return values.signed(value, minus % 2 == 1, offset) if count else value

    def power(self) -> Evaluate:
        value = self.postfix()
        mark = self.take("**")
        if mark is None:
            return value
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise syntax_error("the expression is nested too deeply", mark.offset)
        value = values.chain(value, [("**", self.unary(), mark.offset)])
        self.depth -= 1
        return value

    def postfix(self) -> Evaluate:
        value = self.atom()
        count = 0
        while True:
            mark = self.token
            count += 1
            if count > MAX_DEPTH:
                raise syntax_error("the expression is nested too deeply", mark.offset)
            if self.take("."):
                name = self.token
                if name.kind != "name":
                    raise syntax_error("a name is wanted after `.`", name.offset)
                self.position += 1
                value = values.attribute(value, name.text, name.offset)
            elif self.take("["):
                index = self.choice()
                self.expect("]")
                value = values.index(value, index, mark.offset)
            else:
                return value

    def atom(self) -> Evaluate:
        token = self.token
        self.position += 1
        if token.kind in ("number", "text"):
            return values.constant(token)
        if token.kind == "name":
            if self.take("("):
                return self.call(token)
            return values.look_up_name(token.text, token.offset)
        if token.kind == "operator" and token.text == "(":
            value = self.choice()
            self.expect(")")
            return value
        if token.kind == "operator" and token.text == "[":
            return values.list_of(self.elements("]"))
        self.position -= 1
        if token.kind == END:
            raise syntax_error("the expression ends where a value is wanted", token.offset)
        raise syntax_error(f"a value is wanted here, not `{token.text}`", token.offset)

    def elements(self, closing: str) -> list[Evaluate]:
        values: list[Evaluate] = []
        while not self.take(closing):
            if values:
                self.expect(",")
                if self.take(closing):
                    break
            values.append(self.choice())
        return values

    def call(self, token: Token) -> Evaluate:
        known = values.FUNCTIONS.get(token.text)
        if known is None:
            raise ExpressionError(
                f"there is no function `{token.text}`",
                token.offset,
                hint=did_you_mean(
                    token.text, values.FUNCTIONS, "the functions are " + " ".join(values.FUNCTIONS)
                ),
                code="expression-name",
            )
        arguments = self.elements(")")
        function, count = known
        if (count and len(arguments) != count) or not arguments:
            wanted = {0: "at least 1 value", 1: "1 value"}.get(count, f"{count} values")
            raise syntax_error(f"`{token.text}` takes {wanted}, not {len(arguments)}", token.offset)
        return values.call(token.text, function, arguments, token.offset)
