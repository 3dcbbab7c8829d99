"""The small changes of the package that ``mutants.py`` makes, and samples of them."""

from __future__ import annotations

import ast
import copy
import random
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from executed_lines import ROOT

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
SYMMETRIC = ("allclose", "gcd", "hypot", "isclose", "max", "min")
"""Functions whose result does not depend on the order of their arguments."""


class Mutant(NamedTuple):
    """One change: characters ``start`` to ``end`` of a file become ``text``."""

    path: Path
    line: int
    executed: range
    """The lines of its statement, without an inner block; empty outside of functions."""
    start: int
    end: int
    text: str

    def apply(self, source: str) -> str:
        return source[: self.start] + self.text + source[self.end :]

    def describe(self) -> str:
        before = (ROOT / self.path).read_text()[self.start : self.end]
        old, new = (" ".join(text.split()) for text in (before, self.text))
        return f"{self.path}:{self.line}: {old}  ->  {new}"


def changed_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Returns the nodes by which ``node`` can be replaced."""
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in COMPARISONS:
            new = copy.deepcopy(node)
            new.ops = [COMPARISONS[type(operator)]()]
            yield new
        case ast.BinOp(op=operator) if type(operator) in OPERATORS:
            if not isinstance(node.left, ast.Constant | ast.JoinedStr) or _is_number(node.left):
                new_operation = copy.deepcopy(node)
                new_operation.op = OPERATORS[type(operator)]()
                yield new_operation
        case ast.BoolOp():
            new_choice = copy.deepcopy(node)
            new_choice.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield new_choice
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.Constant(value=bool()):
            yield ast.Constant(not node.value)
        case ast.Constant(value=int()):
            yield ast.Constant(node.value + 1)
        case ast.Constant(value=float()):
            yield ast.Constant(1.0 if node.value == 0.0 else node.value * 1.5)
        case ast.Call(args=[first, second, *rest]) if _order_matters(node):
            swapped = copy.deepcopy(node)
            swapped.args = [second, first, *rest]
            yield swapped
        case ast.Expr(value=ast.Call()) | ast.AugAssign():
            yield ast.Pass()
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()


def _order_matters(call: ast.Call) -> bool:
    """Checks whether a call with its first two arguments swapped is another call."""
    name = ast.unparse(call.func).rpartition(".")[2]
    first, second = call.args[:2]
    return name not in SYMMETRIC and ast.dump(first) != ast.dump(second)


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def mutants_of(path: Path) -> list[Mutant]:
    """Returns all mutants of a file below the root of the repository."""
    source = (ROOT / path).read_text()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    mutants: list[Mutant] = []
    _collect(ast.parse(source), _Place(path, source, starts, mutants), range(0), False)
    return mutants


class _Place(NamedTuple):
    """A file, the index of the first character of each line, and its mutants so far."""

    path: Path
    source: str
    starts: list[int]
    mutants: list[Mutant]


def _collect(node: ast.AST, place: _Place, executed: range, is_function: bool) -> None:
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        in_function = is_function or (
            field == "body" and isinstance(node, ast.FunctionDef | ast.Lambda)
        )
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or _is_untested(child):
                continue
            inner = executed
            if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
                inner = _header(child) if in_function else range(0)
            for new in changed_nodes(child):
                start = _offset(place, child.lineno, child.col_offset)
                end = _offset(place, child.end_lineno, child.end_col_offset)
                text = ast.unparse(new)
                if isinstance(child, ast.expr):
                    text = f"({text})"
                place.mutants.append(Mutant(place.path, child.lineno, inner, start, end, text))
            _collect(child, place, inner, in_function)


def _header(node: ast.stmt | ast.excepthandler | ast.match_case) -> range:
    """Returns the lines of a statement up to its first inner statement."""
    first = node.pattern.lineno if isinstance(node, ast.match_case) else node.lineno
    body = getattr(node, "body", None) or getattr(node, "cases", None)
    if not body:
        return range(first, node.end_lineno + 1)
    inner = body[0].pattern.lineno if isinstance(body[0], ast.match_case) else body[0].lineno
    return range(first, max(inner, first + 1))


def _is_untested(node: ast.AST) -> bool:
    """Checks whether a node is a text for people, or an import for types."""
    match node:
        case ast.Raise() | ast.Assert() | ast.JoinedStr():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
    return False


def _offset(place: _Place, line: int, column: int) -> int:
    """Returns the index of a character; ``column`` counts bytes of UTF-8, as ``ast`` does."""
    text = place.source[place.starts[line - 1] : place.starts[line]]
    return place.starts[line - 1] + len(text.encode()[:column].decode())


def sample(layer: str, number: int, seed: int) -> list[Mutant]:
    """Returns ``number`` mutants of a layer, each as likely as any other."""
    folder = ROOT / "thorvaldc" / layer
    files = sorted(path.relative_to(ROOT) for path in folder.rglob("*.py"))
    mutants = [mutant for path in files for mutant in mutants_of(path)]
    return random.Random(f"{layer}:{seed}").sample(mutants, min(number, len(mutants)))
