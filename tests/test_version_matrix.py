"""Tests of ``workshop/test_matrix.py``: which failures of other versions are errors."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "workshop"))
    monkeypatch.delitem(sys.modules, "test_matrix", raising=False)
    tool = importlib.import_module("test_matrix")
    pythons = {(3, 11): "/old/python", (3, 14): "/new/python"}
    monkeypatch.setattr(tool, "pythons", lambda: pythons)
    return tool


def verdict(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, failing: set[str], newer: list[str]
) -> tuple[int, list[str]]:
    """Returns the exit status where these combinations fail, and what ran."""
    ran: list[str] = []

    def run(combination: tuple[object, ...]) -> bool:
        ran.append(combination.name)  # type: ignore[attr-defined]
        return ran[-1] not in failing

    monkeypatch.setattr(tool, "run", run)
    monkeypatch.setattr(tool, "newer_packages", lambda combination: newer)
    return tool.main([]), ran


ALL = ["3.11-lowest", "3.14-lowest", "3.14-newest"]
NEWER = ["pyyaml 6.0.4 (locked: 6.0.3)"]


@pytest.mark.parametrize(
    ("failing", "newer", "status", "ran"),
    [
        (set(), NEWER, 0, ALL),
        ({"3.14-newest"}, NEWER, 0, [*ALL, "3.14-locked"]),
        ({"3.14-newest", "3.14-locked"}, NEWER, 1, [*ALL, "3.14-locked"]),
        ({"3.14-newest"}, [], 1, ALL),
        ({"3.11-lowest"}, NEWER, 1, ALL),
        ({"3.14-lowest", "3.14-newest"}, NEWER, 1, [*ALL, "3.14-locked"]),
    ],
)
def test_only_a_failure_of_newer_packages_alone_is_no_error(
    tool: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    failing: set[str],
    newer: list[str],
    status: int,
    ran: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert verdict(tool, monkeypatch, failing, newer) == (status, ran)
    is_warned = "3.14-newest" in failing and bool(newer) and "3.14-locked" not in failing
    printed = capsys.readouterr().out
    assert ("WARNING: 3.14-newest fails and 3.14-locked passes" in printed) == is_warned
    assert (NEWER[0] in printed) == is_warned


def test_packages_newer_than_the_lock_are_named(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The packages of this environment, and a lock with another version of one of them."""
    monkeypatch.setattr(tool, "FOLDER", tmp_path)
    combination = tool.Combination((3, 14), sys.executable, "newest")
    assert tool.newer_packages(combination) == [
        "the newest versions cannot be installed together, see above"
    ]
    home = tmp_path / "3.14-newest"
    (home / "bin").mkdir(parents=True)
    (home / "ready").touch()
    installed = '[{"name": "pyyaml", "version": "6.0.4"}, {"name": "other", "version": "1"}]'
    program = tmp_path / "uv"
    program.write_text(f"#!/bin/sh\necho '{installed}'\n", encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setattr(tool, "UV", [str(program)])
    lock = tmp_path / "lock.txt"
    monkeypatch.setattr(tool, "LOCK", str(lock))
    lock.write_text("other==1.0\npyyaml==6.0.4\n    # via x\n", encoding="utf-8")
    assert tool.newer_packages(combination) == []
    lock.write_text("pyyaml==6.0.3 ; python_version > '3'\n", encoding="utf-8")
    assert tool.newer_packages(combination) == [
        "pyyaml 6.0.4 (locked: 6.0.3)",
        "other 1 (locked: none)",
    ]
