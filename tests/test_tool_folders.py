"""The core without its tools."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD
from tests.slow import mostly_slow

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package in which the folders of all tools are deleted, and good.yaml."""
    folder = tmp_path_factory.mktemp("core")
    ignore = shutil.ignore_patterns("__pycache__")
    for room in ("thorvaldc", "modules", "templates", "docs/diagnostics"):
        shutil.copytree(ROOT / room, folder / room, ignore=ignore)
    for tool in (folder / "thorvaldc/tools").iterdir():
        if tool.is_dir():
            shutil.rmtree(tool)
    shutil.copy(ROOT / "pyproject.toml", folder)
    (folder / "good.yaml").write_text(GOOD, encoding="utf-8")
    return folder


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "thorvaldc", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(
    "arguments",
    mostly_slow(
        [
            ("build", "good.yaml"),
            ("sim", "good.yaml", "--twist", "0.3,0,0", "--duration", "0.5"),
            ("run", "good.yaml", "--bus", "virtual", "--duration", "0.2"),
            ("check", "good.yaml"),
            ("can", "plan", "good.yaml", "--bus", "virtual"),
            ("modules", "list"),
            ("explain", "TV501"),
        ],
        quick=2,
        slow=1,
    ),
)
def test_the_core_works_when_all_tools_are_deleted(core: Path, arguments: tuple[str, ...]) -> None:
    result = call(core, *arguments)
    assert result.returncode == 0, result.stderr
    assert result.stdout


def test_the_help_lists_no_tools(core: Path) -> None:
    shown = call(core, "--help").stdout
    assert "Commands:" in shown
    assert "  sim " in shown
    assert not {"audit", "study", "teleop"} & set(shown.split())
    assert "No such command 'diff'" in call(core, "diff", "good.yaml", "good.yaml").stderr
