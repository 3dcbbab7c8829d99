"""The list of outside programs is complete, and `.ci/run` can install it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import outside_tools


def test_a_program_that_is_not_listed_cannot_start() -> None:
    with pytest.raises(AssertionError, match="strace is not listed"):
        subprocess.run(["strace", "true"], check=True)
    subprocess.run(["sh", "-c", "true"], check=True)


def test_the_script_prints_the_packages_of_what_is_missing() -> None:
    command = [sys.executable, outside_tools.__file__]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    missing = [tool.packages for tool in outside_tools.TOOLS if not tool.is_here()]
    assert process.stdout == " ".join(missing) + "\n"
    empty = {"PATH": "/nowhere"}
    process = subprocess.run(command, capture_output=True, text=True, check=True, env=empty)
    assert "liburdfdom-tools" in process.stdout.split()


IN_THE_MODE = """
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import outside_tools
from tests.repository import commit_all
from tests.ros.environments import python_of

ROBOT = "ROOT/examples/1wd1ws_front/robot.yaml"


def test_no_tool_is_found():
    assert not [tool.name for tool in outside_tools.TOOLS if tool.is_here()]
    names = [tool.name for tool in outside_tools.TOOLS]
    assert not list(filter(shutil.which, [*names, "gcc", "g++", "clang", "google-chrome"]))


def test_pictures_end_with_the_documented_message(tmp_path):
    command = [sys.executable, "-m", "thorvaldc", "render", ROBOT]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (3, "")
    assert "neither EGL nor OSMesa works (on Debian and Ubuntu: apt install lib" in done.stderr


@pytest.mark.parametrize("tool", outside_tools.TOOLS, ids=lambda tool: tool.name)
def test_a_test_with_the_tool_is_skipped(tool):
    outside_tools.require(tool.name)


def test_a_test_that_starts_a_program_is_skipped(tmp_path):
    commit_all(tmp_path)


@pytest.mark.parametrize(
    "path",
    [
        outside_tools.path_of_dcfgen,
        outside_tools.path_of_drake_python,
        outside_tools.path_of_dart_python,
        lambda: outside_tools.path_of_usd_python(converter=True),
        lambda: outside_tools.path_of_usd_python(converter=False),
        outside_tools.path_of_warp_python,
        lambda: python_of("jazzy"),
    ],
)
def test_a_test_with_the_environment_is_skipped(path):
    path()
"""


@pytest.mark.slow
def test_the_mode_without_tools_hides_all_of_them(tmp_path: Path) -> None:
    """In a test run of its own, with CI: there a missing tool is no error."""
    root = Path(__file__).parents[1]
    file = tmp_path / "test_in_the_mode.py"
    file.write_text(IN_THE_MODE.replace("ROOT", str(root)))
    # The hooks of tests/conftest.py are those of the file as well.
    plugins = ("-p", "tests.conftest", "-p", "no:cacheprovider", "-c", str(root / "pyproject.toml"))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-n0", *plugins, "--rootdir", str(tmp_path), str(file)],
        capture_output=True,
        text=True,
        check=False,
        cwd=root,
        env={**os.environ, "OUTSIDE": "none", "CI": "true"},
    )
    assert done.returncode == 0, done.stdout
    skipped = len(outside_tools.TOOLS) + 1 + 7
    assert f"2 passed, {skipped} skipped" in done.stdout
    assert f"{2:6} git is not installed (Debian: git)\n" in done.stdout


def test_a_program_that_is_missing_skips_its_test(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match=r"node is not installed \(Debian: nodejs\)"):
        subprocess.run(["node", "--version"], check=True)
    monkeypatch.setenv("CI", "true")
    monkeypatch.setattr(outside_tools, "HIDDEN", False)
    with pytest.raises(pytest.fail.Exception, match="node is not installed"):
        outside_tools.path_of("node")
