"""The house rules of docs/contributing.md, as far as a program can check them."""

from __future__ import annotations

import ast
import os
import re
from collections import Counter
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from typing import TypeGuard

import pytest

from workshop.compiled_runtime import MODULES

# One worker runs these tests: then the package is parsed once.
pytestmark = pytest.mark.xdist_group("house rules")
ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "thorvaldc"
FILES = sorted(PACKAGE.rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
# Lines.  A file over 500 is questioned, and split where two ideas are; no number tells that.
LONGEST_FILE, LONGEST_FUNCTION = 1000, 100

# Names of acts, and pronouns: they do not say which thing a variable holds.
VAGUE = frozenset(
    [
        "asked",
        "done",
        "found",
        "given",
        "held",
        "its",
        "made",
        "one",
        "said",
        "that",
        "told",
        "wanted",
    ]
)


Nodes = dict[Path, list[ast.AST]]
"""The nodes of the syntax tree of each file of the package."""


def functions(nodes: list[ast.AST]) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def bound_names(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    """Line and name of every local variable, parameter and caught exception."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.ExceptHandler) and node.name:
            yield node.lineno, node.name


@pytest.fixture(scope="module")
def package() -> Nodes:
    return {path: [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))] for path in FILES}


def test_no_file_and_no_function_is_too_long(package: Nodes) -> None:
    long_files = [
        str(path.relative_to(ROOT))
        for path in (*FILES, *TESTS)
        if path.read_text(encoding="utf-8").count("\n") > LONGEST_FILE
    ]
    long_functions = [
        f"{path.relative_to(ROOT)}:{function.lineno} {function.name}"
        for path, nodes in package.items()
        for function in functions(nodes)
        if (function.end_lineno or 0) - function.lineno + 1 > LONGEST_FUNCTION
    ]
    assert (long_files, long_functions) == ([], [])


def test_every_file_of_the_package_has_its_own_name() -> None:
    """A reader who looks for a subject finds one file; commands carry the name of what they do."""
    names = Counter(path.name for path in FILES if path.name not in ("__init__.py", "__main__.py"))
    assert [name for name, count in names.items() if count > 1] == []


def test_no_file_has_a_name_without_content() -> None:
    empty = {"utils.py", "util.py", "helpers.py", "helper.py", "misc.py", "common.py", "base.py"}
    assert [str(path) for path in FILES if path.name in empty] == []


def test_variables_name_things(package: Nodes) -> None:
    vague = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for path, nodes in package.items()
        for line, name in bound_names(nodes)
        if name in VAGUE
    ]
    assert vague == []


def test_exceptions_are_errors(package: Nodes) -> None:
    """A fault is a state of the driver or of a device; a Python exception is an error."""
    named_fault = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, nodes in package.items()
        for node in nodes
        if isinstance(node, ast.ExceptHandler) and node.name == "fault"
    ]
    assert named_fault == []


# Sums of integers that `counts` does not see as such.
INTEGER_SUMS = frozenset(
    [
        "sum((bit for bit, is_set in bits if is_set))",
        "sum(((m[0] & USE_ROLL > 0) + (m[0] & USE_SIDE > 0) for m in measurements))",
        "sum((slot.value & 255 for slot in self.slots[:value]))",
        "sum((1 << m - 1 for m in Mode))",
        "sum((OBJECT_TYPES[kind][1] for _, _, kind in mapping))",
        "sum((self.executor.nodes_at[node] for node in ids))",
        "sum(groups.values())",
        "sum(map(fleet_compilation.robots_of, entries))",
        "sum(base.nodes.relay_drops().values())",
        "sum(sizes)",
    ]
)


def counts(argument: ast.expr) -> bool:
    """Whether the argument of ``sum`` is ones or lengths: ``1 for ...``, ``len(x) + 1 for ...``."""
    if not isinstance(argument, ast.GeneratorExp):
        return False
    element = argument.elt
    if isinstance(element, ast.BinOp):
        element = element.left
    if isinstance(element, ast.Call):
        return isinstance(element.func, ast.Name) and element.func.id == "len"
    return isinstance(element, ast.Constant) and type(element.value) is int


def test_floats_are_added_alike_on_every_python(package: Nodes) -> None:
    """``sum`` rounds floats in another way since Python 3.12; ``float_sum`` does not."""
    sums = []
    for path, nodes in package.items():
        integer_sums = {
            node.func
            for node in nodes
            if is_call(node, "sum")
            and (ast.unparse(node) in INTEGER_SUMS or (node.args and counts(node.args[0])))
        }
        sums += [
            f"{path.relative_to(ROOT)}:{node.lineno}"
            for node in nodes
            if isinstance(node, ast.Name) and node.id == "sum" and node not in integer_sums
        ]
    assert sums == []


def is_call(node: ast.AST, name: str) -> TypeGuard[ast.Call]:
    """Whether a node calls a function or a method whose dotted name ends with ``name``."""
    if not isinstance(node, ast.Call):
        return False
    last = getattr(node.func, "attr", getattr(node.func, "id", ""))
    # Most calls differ in the last part of the name already: `unparse` takes long.
    return last.endswith(name.split(".")[-1]) and ast.unparse(node.func).endswith(name)


def calls(package: Nodes, name: str) -> set[str]:
    """Returns the files of the package that call a function or a method ``name``."""
    return {
        path.relative_to(PACKAGE).as_posix()
        for path, nodes in package.items()
        for node in nodes
        if is_call(node, name)
    }


def nodes_with(text: str) -> Iterator[tuple[Path, ast.AST]]:
    """Yields the nodes of all files of the tests in which ``text`` occurs."""
    for path in TESTS:
        content = path.read_text(encoding="utf-8")
        if text in content:
            yield from ((path, node) for node in ast.walk(ast.parse(content)))


def test_json_of_others_is_read_in_one_place(package: Nodes) -> None:
    """``json.loads`` raises ``RecursionError`` for nested brackets, and is for texts of our own."""
    assert calls(package, "json.loads") | calls(package, "json.load") == present(
        "compiler/output/writer.py",
        "compiler/sandbox/worker_protocol.py",
        "diagnostics/files.py",
        "schema/__init__.py",
        "comparison/robot_difference.py",
    )


def present(*paths: str) -> set[str]:
    """Returns the paths without those of tools that are deleted (``make test-core``)."""
    return {path for path in paths if (PACKAGE / path).parent.is_dir()}


def test_files_are_written_in_one_place(package: Nodes) -> None:
    """A full disk leaves a half file behind ``write_text``; these write to temporary folders."""
    assert calls(package, ".write_text") | calls(package, "path.write_bytes") == present(
        "cli/robot_file.py",  # a mark whose content does not count
        "compiler/output/writer.py",
        "simulation/physics/mujoco_scene.py",
    )


def test_one_file_creates_and_changes_the_permission_to_move(package: Nodes) -> None:
    """What is explored in tests/runtime/exploration.py is what moves the robot."""
    makers = {
        path.relative_to(PACKAGE).as_posix()
        for path, nodes in package.items()
        for node in nodes
        if (isinstance(node, ast.Name) and node.id in ("Permission", "SourceState", "LockState"))
        or (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and ast.unparse(node).endswith("permission.value")
        )
    }
    assert makers == {"runtime/permission.py"}


def test_one_place_commands_the_joints_of_a_robot(package: Nodes) -> None:
    assert calls(package, "base.write") == {
        "runtime/driver.py",
        "simulation/bus/simulated_motors.py",  # the physics behind the simulated bus
    }


def pads_text(node: ast.AST) -> bool:
    """Whether a node pads a text to a width that is computed."""
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        return name in ("ljust", "rjust") and len(node.args) == 1
    if isinstance(node, ast.FormattedValue) and isinstance(node.format_spec, ast.JoinedStr):
        first, *others = node.format_spec.values
        is_fill = isinstance(first, ast.Constant) and str(first.value) in "<>^"
        return isinstance(first, ast.FormattedValue) or (is_fill and bool(others))
    return False


def test_columns_and_markdown_are_laid_out_in_one_place(
    package: Nodes,
) -> None:
    padding = {
        path.relative_to(PACKAGE).as_posix()
        for path, nodes in package.items()
        if any(map(pads_text, nodes))
    }
    escapers = {
        path.relative_to(PACKAGE).as_posix()
        for path, nodes in package.items()
        for node in nodes
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and "*_[" in node.value
    }
    assert escapers == {"diagnostics/text_layout.py"}
    assert padding == {
        "cli/diagnostic_output.py",  # a bar
        "model/stl.py",  # bytes
        "diagnostics/renderers.py",  # line numbers beside an excerpt
        "diagnostics/text_layout.py",
    }


def test_tests_start_processes_that_end_with_them() -> None:
    popen = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, node in nodes_with("Popen")
        if is_call(node, "Popen")
    ]
    assert popen == [], "tests use ChildProcess of tests/child_process.py"


def test_tests_of_the_core_import_nothing_from_a_tool() -> None:
    """`make test-core` runs them without the folders of the tools, and without their tests."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    deleted = tuple(re.findall(r"':!(tests/[^']+)'", makefile))
    assert "tests/tools" in deleted
    imports = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.module}"
        for path, node in nodes_with(".tools")
        if not path.relative_to(ROOT).as_posix().startswith(deleted)
        and isinstance(node, ast.ImportFrom)
        and f"{node.module}.".startswith(("tests.tools.", "thorvaldc.tools."))
    ]
    assert imports == []


def test_groups_are_respected(request: pytest.FixtureRequest) -> None:
    if "PYTEST_XDIST_WORKER" not in os.environ:
        pytest.skip("pytest runs in one process")
    assert request.node.nodeid.endswith("@house rules"), "a group runs in one process"


def test_no_modules_import_each_other(package: Nodes) -> None:
    """Neither in turn: what a module needs can be read before it.  Imports for types count, too."""
    names = {
        path: ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in FILES
        if path != PACKAGE / "__init__.py"  # the API of all rooms, for type checkers
    }
    modules = set(names.values())
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for path, name in names.items():
        for node in package[path]:
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    module = f"{node.module}.{alias.name}"
                    imported = module if module in modules else str(node.module)
                    if imported in modules:
                        sorter.add(name, imported)
    sorter.prepare()  # raises CycleError, which names the circle


def test_interpreted_classes_inherit_from_compiled_ones_that_allow_it(package: Nodes) -> None:
    """The others cannot be created in a compiled wheel (``runtime/mypyc_marks.py``)."""
    modules = {PACKAGE / f"{module}.py" for module in MODULES}
    classes = {
        path: [node for node in nodes if isinstance(node, ast.ClassDef)]
        for path, nodes in package.items()
    }
    closed = {
        node.name
        for path in modules
        for node in classes[path]
        if "mypyc_attr(allow_interpreted_subclasses=True)"
        not in map(ast.unparse, node.decorator_list)
    }
    subclasses = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}({name})"
        for path in FILES
        if path not in modules
        for node in classes[path]
        for base in node.bases
        if (name := ast.unparse(base).partition("[")[0].rpartition(".")[2]) in closed
    ]
    assert subclasses == []
