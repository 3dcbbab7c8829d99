"""Every document results in diagnostics or a robot, without a traceback and within a time limit.

The tests compile 5000 mutations of the examples and of the library's modules: mutations of
the text and of the YAML tree.  Every run has the same mutations.
"""

from __future__ import annotations

import copy
import json
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.slow import mostly_slow
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics.renderers import FORMATS, render

ROOT = Path(__file__).parents[2]
LIMIT = 5.0  # s of processor time per document; most take some 10 ms

ROBOTS = [
    path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "examples").glob("*/robot.yaml"))
    if "extras:" not in path.read_text(encoding="utf-8")  # a process per document is too slow here
]
MODULES = [
    (path.parent.relative_to(ROOT / "modules").as_posix(), path.read_text(encoding="utf-8"))
    for path in sorted((ROOT / "modules").glob("*/*/module.yaml"))
]
ROBOT_WITH_MODULE = """thorvaldc: 1
name: r
library: [lib]
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: caster/fixed, mount: frame.front_right}
  rear: {type: caster/fixed, mount: frame.rear_center}
  part: {type: TYPE, mount: {parent: frame}}
"""

# Texts that cause errors in YAML, units, references and expressions.
PIECES = [
    *("", " ", "\n", "\t", ":", ": ", "- ", "{", "}", "[", "]", ",", '"', "'", "#", "&a ", "*a"),
    *("|", ">", "!x ", "%", "@", "?", "---\n", "\x00", "\ufeff", "\u2028", "é", "日本", "\r\n"),
    *("null", "~", "true", "on", "010", "0x10", "1e3", "1e999", ".inf", ".nan", "-1", "0", "1.5"),
    *("42:1", "5 kg", "5 mm", "5 mn", "-5 m", "1e400 m", "90 deg", "1/0", "none", "auto", "a.b.c"),
    *("${", "}", "${x}", "${1/0}", "${pi}", "${2**9**9}", "${[1]}", "${wheel}", "${-length}"),
    *("xyz", "rpy", "mount", "params", "type", "can", "modules", "links", "frame", "fl", "<<"),
]
VALUES: list[Any] = [
    *(None, True, False, 0, -1, 3, 10**30, 0.0, -0.5, 1e-300, 1e300, "", "x", "none", "auto"),
    *("5 kg", "5 mm", "-5 mm", "0 m", "90 deg", "42:1", "1e300 m", "frame.front_left", "fl"),
    *("${x}", "${1/0}", "${pi}", "${length}", "${10**300}", "${'a'}", "${[1, 2]}", "frame/open"),
    *([], [0, 0, 0], [1, 2], ["a", "b", "c"], [[]], {}, {"type": "frame/open"}, {"a": 1}),
    *({"port": "frame.front_left"}, {"parent": "fl"}, {"x": {"quantity": "length"}}),
]


class TooSlow(Exception):
    """A document took four times the limit."""


@contextmanager
def time_limit() -> Iterator[None]:
    """Fails after LIMIT; interrupts the block after four times LIMIT."""

    def stop(*_: object) -> None:
        raise TooSlow(f"more than {4 * LIMIT} s")

    previous = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, 4 * LIMIT)
    start = time.process_time()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous)
    assert time.process_time() - start < LIMIT


def compile_and_show(robot: bytes, module: tuple[str, bytes] | None = None) -> None:
    """Compiles a robot file and a module of its library, and renders the diagnostics."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz"))
    try:
        path = folder / "robot.yaml"
        path.write_bytes(robot)
        if module is not None:
            module_file = folder / "lib" / module[0] / "module.yaml"
            module_file.parent.mkdir(parents=True)
            module_file.write_bytes(module[1])
        with time_limit():
            compilation = compile_file(path)
            assert compilation.model is not None or compilation.report.has_errors
            if compilation.model is not None:
                emit(compilation.model, DEFAULT_TARGETS, compilation.report)
            for form in FORMATS:
                render(compilation.report, form, compilation.sources)
    finally:
        shutil.rmtree(folder)


def examples(count: float) -> Callable[[Any], Any]:
    """Returns Hypothesis settings: ``count`` examples, the same in every run."""
    return settings(
        max_examples=round(count),
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


SHARES = pytest.mark.parametrize("share", mostly_slow([0.03, 0.2, 1.0], slow=1))


# -- text -----------------------------------------------------------------------------

positions = st.floats(0, 1, exclude_max=True)
edits = st.lists(
    st.tuples(
        st.sampled_from(["insert", "replace", "delete", "swap lines", "repeat", "cut"]),
        positions,
        positions,
        st.one_of(st.sampled_from(PIECES), st.text(max_size=4)),
    ),
    min_size=1,
    max_size=3,
)


def edit_text(text: str, operations: list[tuple[str, float, float, str]]) -> bytes:
    """Applies edits to a text; positions are fractions of its length."""
    for operation, first, second, piece in operations:
        at = int(first * len(text))
        if operation == "insert":
            text = text[:at] + piece + text[at:]
        elif operation == "replace":
            text = text[:at] + piece + text[at + max(len(piece), 1) :]
        elif operation == "delete":
            text = text[:at] + text[at + 1 + int(second * 20) :]
        elif operation == "cut":
            text = text[:at]
        else:
            lines = text.splitlines(True) or [""]
            i, j = int(first * len(lines)), int(second * len(lines))
            if operation == "repeat":
                lines.insert(j, lines[i])
            else:
                lines[i], lines[j] = lines[j], lines[i]
            text = "".join(lines)
    return text.encode("utf-8", "surrogatepass")


@SHARES
def test_text_of_robots(share: float) -> None:
    @examples(1500 * share)
    @given(st.sampled_from(ROBOTS), edits)
    def check(text: str, operations: list[tuple[str, float, float, str]]) -> None:
        compile_and_show(edit_text(text, operations))

    check()


@SHARES
def test_text_of_modules(share: float) -> None:
    @examples(1000 * share)
    @given(st.sampled_from(MODULES), edits)
    def check(module: tuple[str, str], operations: list[tuple[str, float, float, str]]) -> None:
        name, text = module
        robot = ROBOT_WITH_MODULE.replace("TYPE", name).encode()
        compile_and_show(robot, (name, edit_text(text, operations)))

    check()


# -- trees ------------------------------------------------------------------------------

changes = st.lists(
    st.tuples(
        st.sampled_from(["set", "set", "remove", "rename", "add", "copy"]),
        positions,
        positions,
        st.one_of(
            st.sampled_from(VALUES),
            st.integers(-(2**70), 2**70),
            st.floats(allow_nan=False, allow_infinity=False),
            st.text(max_size=8),
        ),
    ),
    min_size=1,
    max_size=3,
)


def holders(tree: Any) -> list[tuple[Any, Any]]:
    """Returns every value in a tree as its mapping or list and its key or index."""
    all_holders: list[tuple[Any, Any]] = []
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(entries):
        all_holders.append((tree, key))
        if isinstance(value, dict | list):
            all_holders.extend(holders(value))
    return all_holders


def change_tree(tree: Any, operations: list[tuple[str, float, float, Any]]) -> bytes:
    """Applies changes to a tree in place; returns it as JSON, which is also YAML."""
    for operation, first, second, drawn in operations:
        value = copy.deepcopy(drawn)
        all_holders = holders(tree)
        if not all_holders:
            break
        holder, key = all_holders[int(first * len(all_holders))]
        if operation == "set":
            holder[key] = value
        elif operation == "remove":
            del holder[key]
        elif operation == "rename" and isinstance(holder, dict):
            holder[value if isinstance(value, str) else "renamed"] = holder.pop(key)
        elif operation == "add" and isinstance(holder, dict):
            holder[PIECES[int(second * len(PIECES))]] = value
        else:  # copied, because a cyclic tree cannot be written
            source, name = all_holders[int(second * len(all_holders))]
            holder[key] = json.loads(json.dumps(source[name]))
    return json.dumps(tree, ensure_ascii=False).encode("utf-8", "surrogatepass")


@SHARES
def test_trees_of_robots(share: float) -> None:
    @examples(1500 * share)
    @given(st.sampled_from(ROBOTS), changes)
    def check(text: str, operations: list[tuple[str, float, float, Any]]) -> None:
        compile_and_show(change_tree(yaml.safe_load(text), operations))

    check()


@SHARES
def test_trees_of_modules(share: float) -> None:
    @examples(1000 * share)
    @given(st.sampled_from(MODULES), changes)
    def check(module: tuple[str, str], operations: list[tuple[str, float, float, Any]]) -> None:
        name, text = module
        robot = ROBOT_WITH_MODULE.replace("TYPE", name).encode()
        compile_and_show(robot, (name, change_tree(yaml.safe_load(text), operations)))

    check()


@pytest.mark.parametrize("text", ["", "thorvaldc: 1\n", "[]", "1", "{}", "null", "a: b\n", "\x00"])
def test_nearly_empty_documents(text: str) -> None:
    compile_and_show(text.encode())
