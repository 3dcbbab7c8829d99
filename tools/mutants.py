"""Changes the package in small ways and checks that a test fails.

    make mutants LAYER=runtime NUMBER=20 SEED=1    a sample of one layer
    tools/mutants.py --layer can --list            show the sample, run nothing

A mutant is the package with one change: another comparison, a sign, a number, a deleted statement,
two swapped arguments.  A mutant that no test notices is a hole in the tests, or the change makes no
difference (an equivalent mutant); a person judges.  The same seed gives the same mutants as long as
the layer does not change.

For each mutant, the test file of the module runs first, then the tests of the layer, then tests
that use the layer.  The first failure ends the tests of the mutant.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("thorvaldc", "tests", "modules", "templates", "examples", "docs", "tools", "bench")
COPIED_FILES = ("pyproject.toml", "README.md", "CHANGELOG.md", "Makefile", "LICENSE")
TIME_LIMIT = 1200.0
"""s for all tests of one mutant; a mutant that takes longer is noticed."""
USERS = {
    "backends": ("tests/golden",),
    "can": ("tests/runtime/can_base", "tests/commissioning", "tests/tools/monitor"),
    "compiler": ("tests/golden", "tests/diagnostics", "tests/backends"),
    "diagnostics": ("tests/compiler/source", "tests/cli"),
    "model": ("tests/golden", "tests/compiler", "tests/backends", "tests/runtime"),
    "runtime": ("tests/simulation", "tests/tools/fault_matrix", "tests/conformance"),
    "simulation": ("tests/runtime", "tests/commissioning", "tests/conformance"),
    "tools": ("tests/cli",),
}
"""Further tests of each layer, besides the layer's own."""
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
    _collect(ast.parse(source), path, source, starts, mutants)
    return mutants


def _collect(
    node: ast.AST, path: Path, source: str, starts: list[int], mutants: list[Mutant]
) -> None:
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or _is_untested(child):
                continue
            for new in changed_nodes(child):
                start = _offset(source, starts, child.lineno, child.col_offset)
                end = _offset(source, starts, child.end_lineno, child.end_col_offset)
                text = ast.unparse(new)
                if isinstance(child, ast.expr):
                    text = f"({text})"
                mutants.append(Mutant(path, child.lineno, start, end, text))
            _collect(child, path, source, starts, mutants)


def _is_untested(node: ast.AST) -> bool:
    """Checks whether a node is a text for people, or an import for types."""
    match node:
        case ast.Raise() | ast.Assert() | ast.JoinedStr():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
    return False


def _offset(source: str, starts: list[int], line: int, column: int) -> int:
    """Returns the index of a character; ``column`` counts bytes of UTF-8, as ``ast`` does."""
    text = source[starts[line - 1] : starts[line]]
    return starts[line - 1] + len(text.encode()[:column].decode())


def sample(layer: str, number: int, seed: int) -> list[Mutant]:
    """Returns ``number`` mutants of a layer, each as likely as any other."""
    folder = ROOT / "thorvaldc" / layer
    files = sorted(path.relative_to(ROOT) for path in folder.rglob("*.py"))
    mutants = [mutant for path in files for mutant in mutants_of(path)]
    return random.Random(f"{layer}:{seed}").sample(mutants, min(number, len(mutants)))


def stages(layer: str, path: Path) -> list[list[str]]:
    """Returns the tests of a mutant, in the order in which they run."""
    inner = path.relative_to("thorvaldc")
    nearest = ROOT / "tests" / inner.parent
    while not nearest.exists():
        nearest = nearest.parent
    own = [
        str(p.relative_to(ROOT))
        for p in sorted(nearest.rglob(f"test_*{inner.stem.strip('_')}*.py"))
    ]
    result = [own] if own else []
    result.append([f"tests/{layer}"])
    result += [[user] for user in USERS.get(layer, ()) if (ROOT / user).exists()]
    return result


def is_noticed(mutant: Mutant, layer: str, tree: Path) -> str:
    """Runs the tests of a mutant in the copy ``tree``; returns the test that failed, or ''."""
    file = tree / mutant.path
    original = file.read_text()
    file.write_text(mutant.apply(original))
    end = time.monotonic() + TIME_LIMIT
    try:
        for tests in stages(layer, mutant.path):
            command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "--no-header"]
            command += ["-p", "no:cacheprovider", "--timeout=120", *tests]
            environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
            try:
                run = subprocess.run(
                    command,
                    cwd=tree,
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=max(end - time.monotonic(), 1.0),
                    check=False,
                )
            except subprocess.TimeoutExpired:
                return "the time limit"
            if run.returncode not in (0, 5):
                failed = [
                    line for line in run.stdout.splitlines() if line[:6] in ("FAILED", "ERROR ")
                ]
                return failed[0].split(" - ")[0] if failed else f"exit status {run.returncode}"
        return ""
    finally:
        file.write_text(original)


def copy_of_the_tree(folder: Path) -> Path:
    for name in COPIED:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, folder / name, ignore=ignored, dirs_exist_ok=True)
    for name in COPIED_FILES:
        shutil.copy(ROOT / name, folder / name)
    return folder


def run(layer: str, mutants: list[Mutant], jobs: int) -> list[Mutant]:
    """Runs the mutants, prints each result, and returns the mutants that no test noticed."""
    survivors: list[Mutant] = []

    def work(number: int) -> None:
        with tempfile.TemporaryDirectory() as folder:
            tree = copy_of_the_tree(Path(folder))
            for mutant in mutants[number::jobs]:
                failure = is_noticed(mutant, layer, tree)
                if not failure:
                    survivors.append(mutant)
                print(f"{'noticed ' if failure else 'SURVIVED'} {mutant.describe()}", flush=True)
                if failure:
                    print(f"         by {failure}", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(work, range(jobs)))
    return survivors


def main() -> int:
    layers = sorted(p.parent.name for p in (ROOT / "thorvaldc").glob("*/__init__.py"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layer", choices=layers, action="append", help="all, if not given")
    parser.add_argument("--number", type=int, default=10, help="mutants of each layer")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="show the mutants; run no test")
    options = parser.parse_args()
    status = 0
    for layer in options.layer or layers:
        mutants = sample(layer, options.number, options.seed)
        if options.list:
            print(*(mutant.describe() for mutant in mutants), sep="\n")
            continue
        survivors = run(layer, mutants, options.jobs)
        share = 1.0 - len(survivors) / max(len(mutants), 1)
        print(f"{layer}: {share:.0%} of {len(mutants)} mutants noticed", flush=True)
        status |= bool(survivors)
    return status


if __name__ == "__main__":
    sys.exit(main())
