"""Changes the package in small ways and checks that a test fails.

    make mutants LAYER=runtime NUMBER=20 SEED=1    a sample of one layer
    workshop/mutants.py --layer can --list            show the sample, run nothing

A mutant is the package with one change: another comparison, a sign, a number, a deleted statement,
two swapped arguments.  A mutant that no test notices is a hole in the tests, or the change makes no
difference (an equivalent mutant); a person judges.  The same seed gives the same mutants as long as
the layer does not change.

A mutant runs the tests that execute its line, quick and near ones first, then the other tests of
their files (which may share what a fixture computed), up to a limit.  The first failure ends them.
Which tests execute a line is recorded in ``.mutants/`` by the first run (``executed_lines.py``).
"""

from __future__ import annotations

import argparse
import ast
import copy
import itertools
import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from executed_lines import (
    ROOT,
    ExecutedLines,
    copy_of_the_tree,
    import_dependencies,
    is_recorded,
    record,
    run_tests,
    test_files,
)

TESTS_LIMIT = 120.0
"""s for all tests of one mutant, by the durations of the recording."""
BATCHES = (1.5, 20.0, TESTS_LIMIT)
"""s of tests in each process of a mutant: most mutants are noticed by the first tests."""
COLLECTION = 0.2
"""s to collect a test file."""
SLOW = 1.5
"""s; a slower test may fail by the load of the machine, and is repeated without the mutant."""
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


def tests_of(mutant: Mutant, executed: ExecutedLines) -> Iterator[list[str]]:
    """Returns the tests of a mutant in the order in which they run, those of each process."""
    inner = mutant.path.relative_to("thorvaldc")
    executing: list[tuple[float, str]] = []
    beside: list[tuple[float, str]] = []
    for name, tests in executed.tests_of(mutant.path, mutant.executed):
        file = Path(name)
        if inner.stem.strip("_") in file.stem:
            far = 1.0
        else:
            far = 3.0 if file.is_relative_to("tests" / inner.parent) else 6.0
        # Each file has a share of the time: tests of one file notice similar mutants.
        time = {True: 0.0, False: 0.0}
        for test in sorted(executed.tests_in(name), key=executed.seconds.__getitem__):
            time[test in tests] += far * (executed.seconds[test] + 0.1)
            (executing if test in tests else beside).append((time[test in tests], test))

    batches: list[list[str]] = [[] for _ in BATCHES]
    used = [0.0 for _ in BATCHES]
    files: set[tuple[int, str]] = set()
    number = 0
    for _, test in [*sorted(executing), *sorted(beside)]:
        if test in executed.fails:
            continue
        if used[number] > BATCHES[number]:
            number += 1
            if number == len(BATCHES):
                break
        file = test.partition("::")[0]
        used[number] += executed.seconds[test] + COLLECTION * ((number, file) not in files)
        files.add((number, file))
        batches[number].append(test)
    if not any(batches):
        folder = ROOT / "tests" / inner.parent
        while not folder.exists():
            folder = folder.parent
        batches[0].append(str(folder.relative_to(ROOT)))
    return filter(None, batches)


def is_noticed(mutant: Mutant, tree: Path, executed: ExecutedLines) -> str:
    """Runs the tests of a mutant in the copy ``tree``; returns the test that failed, or ''."""
    original = (tree / mutant.path).read_text()
    try:
        for batch in tests_of(mutant, executed):
            tests = batch
            while tests:
                _write(tree / mutant.path, mutant.apply(original))
                seconds = [executed.seconds.get(test, TESTS_LIMIT) for test in tests]
                outcome = run_tests(
                    tree, tests, 60.0 + 5.0 * sum(seconds), 20.0 + 5.0 * max(seconds)
                )
                if outcome.status == 0:
                    break
                failed = outcome.failure or f"exit status {outcome.status}"
                is_test = "::" in failed  # and no file that cannot be imported
                if executed.seconds.get(failed, 0.0) < SLOW and outcome.status == 1 and is_test:
                    return failed
                again = [failed] if failed in tests else tests
                _write(tree / mutant.path, original)
                without_mutant = run_tests(tree, again, 60.0 + 5.0 * sum(seconds))
                if without_mutant.status == 0:
                    return failed
                if without_mutant.status == pytest.ExitCode.USAGE_ERROR:
                    raise RuntimeError(f"pytest does not find all of {', '.join(again)}")
                tests = [test for test in tests if test not in again]
        return ""
    finally:
        _write(tree / mutant.path, original)


_moments = itertools.count(1)


def _write(file: Path, text: str) -> None:
    """Writes a file with a time of its own, so that Python does not take an older compiled one."""
    file.write_text(text)
    os.utime(file, (next(_moments), next(_moments)))


_tree: Path
_executed: ExecutedLines


def _start_work(trees: multiprocessing.SimpleQueue[str]) -> None:
    global _tree, _executed
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # ends the forked process too
    _tree = copy_of_the_tree(Path(trees.get()))
    _executed = ExecutedLines()


def _record(name: str) -> str:
    record(name, _tree)
    return name


def _work(mutant: Mutant) -> tuple[Mutant, str, float]:
    """Returns a mutant, what noticed it, and the seconds of CPU."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    failure = is_noticed(mutant, _tree, _executed)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return mutant, failure, cpu


def run(layer: str, mutants: list[Mutant], jobs: int) -> bool:
    """Runs the mutants and prints each result; returns whether a test noticed each of them."""
    with tempfile.TemporaryDirectory() as folder:
        context = multiprocessing.get_context("fork")
        trees = context.SimpleQueue()
        for number in range(2 * jobs):
            trees.put(f"{folder}/{number}")
        missing = [name for name in test_files() if not is_recorded(name)]
        if missing:
            print(f"recording which lines {len(missing)} test files execute", flush=True)
            with context.Pool(jobs, _start_work, (trees,)) as pool:
                for number, name in enumerate(pool.imap_unordered(_record, missing), 1):
                    print(f"{number}/{len(missing)} {name}", flush=True)
        survivors = 0
        total = 0.0
        with context.Pool(jobs, _start_work, (trees,)) as pool:
            for mutant, failure, cpu in pool.imap_unordered(_work, mutants):
                survivors += not failure
                total += cpu
                word = "noticed " if failure else "SURVIVED"
                print(f"{word} {cpu:5.1f} s {mutant.describe()}", flush=True)
                if failure:
                    print(f"                 by {failure}", flush=True)
    number = max(len(mutants), 1)
    print(f"{layer}: {1.0 - survivors / number:.0%} of {len(mutants)} mutants noticed, ", end="")
    noticed = max(len(mutants) - survivors, 1)
    print(f"{total / noticed:.1f} s of CPU for each of them", flush=True)
    return not survivors


def main() -> int:
    layers = sorted(p.parent.name for p in (ROOT / "thorvaldc").glob("*/__init__.py"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layer", choices=layers, action="append", help="all, if not given")
    parser.add_argument("--number", type=int, default=10, help="mutants of each layer")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="show the mutants; run no test")
    options = parser.parse_args()
    import_dependencies()
    status = 0
    for layer in options.layer or layers:
        mutants = sample(layer, options.number, options.seed)
        if options.list:
            print(*(mutant.describe() for mutant in mutants), sep="\n")
            continue
        status |= not run(layer, mutants, options.jobs)
    return status


if __name__ == "__main__":
    sys.exit(main())
