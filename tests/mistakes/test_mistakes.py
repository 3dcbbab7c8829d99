"""Checks documents with typical mistakes: each mistake is named at its line, and said once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.diagnostics.test_hints import check_the_fixes
from tests.slow import one_quick_of
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Diagnostic

TABLE = yaml.safe_load(Path(__file__).with_name("mistakes.yaml").read_text(encoding="utf-8"))
FILES: dict[str, str] = TABLE["files"]
MISTAKES: list[dict[str, Any]] = TABLE["mistakes"]
MAST = "extras:" + FILES["robot.yaml"].partition("extras:")[2]
CHECKED = ("robot.yaml", "cart.yaml", "fleet.yaml", "scenario.yaml")


def write(folder: Path, changed: dict[str, str]) -> None:
    for name, text in {**FILES, **changed}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def with_mistake(name: str, right: str, wrong: str, has_mast: bool) -> dict[str, str]:
    """Returns the documents that a mistake changes.

    The mast is a xacro file, which needs a process: robots without a mistake in its mounting have
    it only on demand.
    """
    changed = {name: FILES[name].replace(right, wrong, 1)}
    robot = {**FILES, **changed}["robot.yaml"]
    return changed if has_mast else {**changed, "robot.yaml": robot.removesuffix(MAST)}


def test_the_documents_have_no_mistakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, {})
    monkeypatch.chdir(tmp_path)
    assert [d.message for name in CHECKED for d in compile_file(name).report] == []


def test_there_are_two_hundred_different_mistakes() -> None:
    changes = {(m["file"], FILES[m["file"]].replace(m["instead"], m["write"], 1)) for m in MISTAKES}
    assert len(changes) == len(MISTAKES) >= 200


def compiled(name: str) -> list[Diagnostic]:
    return list(compile_file(name if name in CHECKED else "robot.yaml").report)


@pytest.mark.parametrize(
    "mistake",
    one_quick_of(4, MISTAKES),
    ids=[f"{n}-{m['code']}" for n, m in enumerate(MISTAKES)],
)
def test_a_mistake_is_named_at_its_line_and_once(
    mistake: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = mistake["file"]
    assert mistake["instead"] in FILES[name]
    has_mast = mistake.get("has_mast", name == "mast.xacro")
    changed = with_mistake(name, mistake["instead"], mistake["write"], has_mast)
    write(tmp_path, changed)
    monkeypatch.chdir(tmp_path)
    report = compiled(name)
    shown = [f"{d.span}: {d.code.number} {d.message} ({d.hint})" for d in report]
    found = [d for d in report if d.code.number == mistake["code"] and mistake["says"] in d.message]
    assert found, shown
    places = [(d.span.file, d.span.line) for d in found if d.span is not None]
    assert (mistake.get("reported_in", name), mistake["line"]) in places, shown
    if "hint" in mistake:
        assert any(d.fixes and (d.hint or "").startswith(mistake["hint"]) for d in found), shown
    if "advice" in mistake:
        hints = [d.hint or "" for d in found if not d.fixes]
        assert any(hint.startswith(mistake["advice"]) for hint in hints), shown
    assert len(report) == mistake.get("diagnostics", 1), shown

    def check(files: dict[str, str]) -> list[Diagnostic]:
        write(tmp_path, files)
        return compiled(name)

    check_the_fixes({**FILES, **changed}, check, mistake.get("uncovers", ()))
