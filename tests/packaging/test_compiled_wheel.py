"""When the hook of the build compiles, and what a compiled wheel gets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hatchling.bridge.app import Application

from workshop import compiled_runtime
from workshop.compiled_runtime import TOOLS, VARIABLE, CompilationError, CustomBuildHook

ROOT = Path(__file__).resolve().parents[2]


def hook_of(root: Path) -> CustomBuildHook:
    given: Any = {}
    return CustomBuildHook(str(root), given, given, given, str(root), "wheel", Application())


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Replaces the compiler; returns the modules of each compilation."""
    calls: list[tuple[str, ...]] = []

    def compile_modules(package: Path, modules: tuple[str, ...], out: Path) -> list[Path]:
        assert package == ROOT / "thorvaldc"
        calls.append(modules)
        return [Path("thorvaldc/runtime/se2.so")]

    monkeypatch.setattr(compiled_runtime, "compile_modules", compile_modules)
    monkeypatch.setattr(compiled_runtime, "find_compiler", lambda: "/usr/bin/cc")
    monkeypatch.delenv(VARIABLE, raising=False)
    return calls


def build(hook: CustomBuildHook, version: str = "standard") -> dict[str, Any]:
    data: dict[str, Any] = {"force_include": {}, "pure_python": True, "infer_tag": False}
    hook.initialize(version, data)
    hook.finalize(version, data, "")
    return data


def test_a_checkout_stays_interpreted(
    compiled: list[tuple[str, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    hook = hook_of(ROOT)
    assert hook.dependencies() == []
    assert build(hook) == {"force_include": {}, "pure_python": True, "infer_tag": False}
    assert compiled == []
    assert "not compiled: THORVALDC_COMPILE=1 does it" in "".join(capsys.readouterr())


@pytest.mark.parametrize("root", [ROOT, ROOT / "thorvaldc/runtime"])
def test_the_variable_compiles_a_wheel_for_this_platform(
    compiled: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch, root: Path
) -> None:
    monkeypatch.setenv(VARIABLE, "1")
    hook = hook_of(root)
    assert hook.dependencies() == TOOLS
    data = build(hook)
    assert (data["pure_python"], data["infer_tag"]) == (False, True)
    assert list(data["force_include"].values()) == ["thorvaldc/runtime/se2.so"]
    names = compiled[0]
    assert ("simulation/control_loop" in names) == (root == ROOT)
    assert "runtime/driver" in names
    assert build(hook, "editable")["pure_python"]
    assert len(compiled) == 1


def test_a_source_distribution_compiles_where_a_compiler_is(
    compiled: list[tuple[str, ...]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "PKG-INFO").touch()
    (tmp_path / "thorvaldc").mkdir()
    assert hook_of(tmp_path).dependencies() == TOOLS
    assert not build(hook_of(tmp_path))["pure_python"]
    monkeypatch.setenv(VARIABLE, "0")
    assert build(hook_of(tmp_path))["pure_python"]
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(compiled_runtime, "find_compiler", lambda: "")
    assert hook_of(tmp_path).dependencies() == []
    assert build(hook_of(tmp_path))["pure_python"]
    assert "not compiled: no C compiler was found" in "".join(capsys.readouterr())


def test_a_compilation_that_fails(
    compiled: list[tuple[str, ...]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object) -> list[Path]:
        raise CompilationError("cc: error: no space")

    monkeypatch.setattr(compiled_runtime, "compile_modules", fail)
    (tmp_path / "PKG-INFO").touch()
    assert build(hook_of(tmp_path))["pure_python"]
    assert "cc: error: no space" in "".join(capsys.readouterr())
    monkeypatch.setenv(VARIABLE, "1")
    with pytest.raises(CompilationError):
        build(hook_of(tmp_path))


def test_every_compiled_module_exists() -> None:
    missing = [m for m in compiled_runtime.MODULES if not (ROOT / f"thorvaldc/{m}.py").is_file()]
    assert missing == []
