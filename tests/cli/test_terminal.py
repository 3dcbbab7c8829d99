"""Colours and progress are for terminals, and only if the user wants them."""

from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import BAD, GOOD


def on_terminal(folder: Path, *arguments: str, **environment: str) -> tuple[int, str]:
    """Status and everything shown, on a terminal of 60 columns."""
    ours, theirs = pty.openpty()
    inherited = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR")}
    with subprocess.Popen(
        [sys.executable, "-m", "thorvaldc", *arguments],
        cwd=folder,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={
            **inherited,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "TERM": "xterm",
            "COLUMNS": "60",
            **environment,
        },
    ) as process:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # the other end is closed
            while part := os.read(ours, 4096):
                shown += part
        os.close(ours)
    return process.returncode, shown.decode()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bad.yaml").write_text(BAD)
    (tmp_path / "good.yaml").write_text(GOOD)
    return tmp_path


def test_faults_have_colours_on_a_terminal(folder: Path) -> None:
    status, shown = on_terminal(folder, "check", "bad.yaml")
    assert status == 1
    assert "\x1b[1;31merror" in shown


@pytest.mark.parametrize("wish", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_no_colours_for_who_wants_none(folder: Path, wish: dict[str, str]) -> None:
    assert "\x1b" not in on_terminal(folder, "check", "bad.yaml", **wish)[1]


def test_excerpts_fit_the_terminal(folder: Path) -> None:
    shown = on_terminal(folder, "check", "bad.yaml", NO_COLOR="1")[1]
    excerpts = [line for line in shown.splitlines() if line.startswith("6 |")]
    assert excerpts
    assert all(len(line) <= 60 for line in excerpts)


def test_machine_formats_have_no_colours_on_a_terminal(folder: Path) -> None:
    for format in ("json", "github", "sarif"):
        assert "\x1b" not in on_terminal(folder, "check", "bad.yaml", "--format", format)[1]


def test_demo_shows_its_progress_on_a_terminal_only(folder: Path) -> None:
    status, shown = on_terminal(folder, "demo", "good.yaml")
    assert status == 0
    assert "1 of 1" in shown
    done = subprocess.run(
        [sys.executable, "-m", "thorvaldc", "demo", "good.yaml"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "1 of 1" not in done.stderr
    assert done.stdout.splitlines()[1].startswith("good ")
    assert "1 file built to build/ and 1 robot driven" in done.stderr
