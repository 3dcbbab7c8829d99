"""Colours and progress appear on terminals only, and only if the user permits them."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import BAD, GOOD, needs_tools


def on_terminal(folder: Path, *arguments: str, **environment: str) -> tuple[int, str]:
    """Returns the status and the output on a terminal of 60 columns."""
    our_end, command_end = pty.openpty()
    inherited = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR")}
    with ChildProcess(
        [sys.executable, "-m", "thorvaldc", *arguments],
        cwd=folder,
        stdin=command_end,
        stdout=command_end,
        stderr=command_end,
        env={
            **inherited,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "TERM": "xterm",
            "COLUMNS": "60",
            **environment,
        },
    ) as process:
        os.close(command_end)
        output = b""
        with contextlib.suppress(OSError):  # the other end is closed
            while part := os.read(our_end, 4096):
                output += part
        os.close(our_end)
    return process.returncode, output.decode()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bad.yaml").write_text(BAD)
    (tmp_path / "good.yaml").write_text(GOOD)
    return tmp_path


def test_diagnostics_have_colours_on_a_terminal(folder: Path) -> None:
    status, output = on_terminal(folder, "check", "bad.yaml")
    assert status == 1
    assert "\x1b[1;31merror" in output


@pytest.mark.parametrize("wish", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_colours_can_be_switched_off(folder: Path, wish: dict[str, str]) -> None:
    assert "\x1b" not in on_terminal(folder, "check", "bad.yaml", **wish)[1]


def test_excerpts_fit_the_terminal(folder: Path) -> None:
    output = on_terminal(folder, "check", "bad.yaml", NO_COLOR="1")[1]
    excerpts = [line for line in output.splitlines() if line.startswith("6 |")]
    assert excerpts
    assert all(len(line) <= 60 for line in excerpts)


def test_machine_formats_have_no_colours_on_a_terminal(folder: Path) -> None:
    for format in ("json", "github", "sarif"):
        assert "\x1b" not in on_terminal(folder, "check", "bad.yaml", "--format", format)[1]


@pytest.mark.slow
@needs_tools
def test_demo_shows_its_progress_on_a_terminal_only(folder: Path) -> None:
    status, output = on_terminal(folder, "demo", "good.yaml")
    assert status == 0
    assert "1 of 1" in output
    process = subprocess.run(
        [sys.executable, "-m", "thorvaldc", "demo", "good.yaml"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "1 of 1" not in process.stderr
    assert process.stdout.splitlines()[1].startswith("good ")
    assert "1 file built to build/ and 1 robot driven" in process.stderr


def test_a_scan_shows_its_progress_and_removes_it(folder: Path) -> None:
    status, output = on_terminal(folder, "can", "scan", "good.yaml", "--bus", "virtual")
    assert status == 0
    progress, _, table = output.partition("\r\x1b[K")
    assert "listening [" in progress
    assert progress.endswith(" 100 %  1 of 1 ")
    assert "listening" not in table
    assert table.startswith("verdict ")


@pytest.mark.slow
def test_a_run_erases_its_status_line_once_before_other_lines(folder: Path) -> None:
    options = ("--bus", "virtual", "--twist", "0.2,0,0", "--duration", "0.1 s")
    status, output = on_terminal(folder, "run", "good.yaml", *options)
    assert status == 0
    assert re.search(r"init  \+0\.0\x1b\[K\r\x1b\[K", output)
    assert "\n\r\x1b[K" not in output
