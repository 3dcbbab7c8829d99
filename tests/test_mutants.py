"""Tests of ``workshop/mutants.py``, which changes the package to test the tests."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "workshop"))
    for name in ("mutants", "code_changes", "executed_lines"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module("mutants")


@pytest.fixture
def changes(tool: ModuleType) -> ModuleType:
    return sys.modules["code_changes"]


def test_a_sample_is_the_same_for_the_same_seed(changes: ModuleType) -> None:
    assert changes.sample("can", 20, 1) == changes.sample("can", 20, 1)
    assert changes.sample("can", 20, 1) != changes.sample("can", 20, 2)


def test_each_mutant_is_another_program(changes: ModuleType) -> None:
    path = Path("thorvaldc/can/sdo.py")
    source = (ROOT / path).read_text()
    original = ast.dump(ast.parse(source))
    mutants = changes.mutants_of(path)
    assert len(mutants) > 50
    assert all(ast.dump(ast.parse(mutant.apply(source))) != original for mutant in mutants)


def test_the_lines_of_a_mutant_are_those_of_its_statement(
    changes: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "example.py").write_text(
        "LIMIT = 3\n"
        "def twice(number: int) -> int:\n"
        "    if (\n"
        "        number == LIMIT\n"
        "    ):\n"
        "        return (\n"
        "            2 * number\n"
        "        )\n"
        "    return 0\n"
    )
    monkeypatch.setattr(changes, "ROOT", tmp_path)
    lines = {m.line: m.executed for m in changes.mutants_of(Path("example.py"))}
    assert lines == {1: range(0), 4: range(3, 6), 7: range(6, 9), 9: range(9, 10)}


def test_a_verdict_counts_until_its_files_change(
    tool: ModuleType, changes: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "example.py"
    source.write_text("def twice(number: int) -> int:\n    return 2 * number + 1\n")
    for module in (tool, changes):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(tool, "RESULTS", tmp_path / "build" / "mutants.jsonl")
    mutants = changes.mutants_of(Path("example.py"))
    noticed, survivor, unjudged, *_ = mutants
    results = tool.Results()
    results.add(noticed, tool.NEAR, "files", tool.Verdict("test_twice", 1, 0), 0.1)
    results.add(survivor, tool.NEAR, "files", tool.Verdict("", 7, 2), 0.1)

    def known(files: str, stage: str = tool.NEAR) -> list[bool]:
        later = tool.Results()
        return [later.find(m, stage, files) is not None for m in (noticed, survivor, unjudged)]

    assert known("files") == [True, True, False]
    assert known("other files") == [True, False, False], "another test may notice a survivor"
    assert known("files", tool.FAR) == [False, False, False]
    source.write_text(source.read_text() + "LIMIT = 3\n")
    assert known("files") == [False, False, False]


def test_pytest_finds_tests_with_any_parameters(tool: ModuleType, tmp_path: Path) -> None:
    values = ["", "[]", "a::b", "{x: 1}", "a b", "1.5"]
    file = tmp_path / "test_example.py"
    file.write_text(
        f"import pytest\n@pytest.mark.parametrize('text', {values})\ndef test_text(text): pass\n"
    )
    tests = [f"{file}::test_text[{value}]" for value in values]
    arguments = sys.modules["executed_lines"].arguments_of(tests)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n0", "-c", os.devnull, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 passed" in done.stdout
