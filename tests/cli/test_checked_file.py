"""``check`` of many files, in several processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import BAD, GOOD, Command
from tests.slow import mostly_slow
from thorvaldc.cli import file_commands
from thorvaldc.cli.file_commands import Check, CheckedFile, check_file, check_files
from thorvaldc.simulation import worker_processes

ROOT = Path(__file__).parents[2]
FILES = ["good.yaml", "bad.yaml", "shaky.yaml", "nowhere.yaml", "own/robot.yaml", "wide.yaml"]
OWN = """\
description: A frame without a box.
links:
  base: {box: {size: [1 m, 1 m, 0.1 m], mass: 10 kg}, unknown: 1}
"""

CHECK = partial(check_file, library=[], set={}, trust=False)


@pytest.fixture
def files(thorvaldc: Command, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Files with errors, warnings and a library of their own, as many as need processes."""
    own = Path("own/modules/frame/own/module.yaml")
    own.parent.mkdir(parents=True)
    own.write_text(OWN, encoding="utf-8")
    text = GOOD.replace("name: good", "name: own\nlibrary: [modules]")
    Path("own/robot.yaml").write_text(
        text + "  box: {type: frame/own, mount: frame.center}\n", encoding="utf-8"
    )
    Path("wide.yaml").write_text(GOOD.replace("width: 0.9 m", "width: 1.2 m"), encoding="utf-8")
    monkeypatch.setattr(file_commands, "FILES_OF_PROCESSES", len(FILES))
    monkeypatch.setattr(worker_processes, "processors", lambda: 2)
    return FILES


@pytest.mark.parametrize("format", mostly_slow(["text", "json", "sarif"], slow=1))
def test_processes_find_what_one_process_finds(
    thorvaldc: Command, files: list[str], format: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes = thorvaldc("check", *files, "--format", format, "--verbose")
    monkeypatch.setattr(file_commands, "FILES_OF_PROCESSES", 1000)
    alone = thorvaldc("check", *files, "--format", format, "--verbose")
    assert processes == alone
    assert processes.status == 1
    if format == "text":
        assert "good.yaml: good, 4 wheels (4 driven, 4 steered)" in processes.out
        assert "did you mean `can`?" in processes.out
        assert "unknown" in processes.out
        assert "nowhere.yaml" in processes.out


@pytest.mark.slow
def test_the_processes_of_a_command_find_it_too(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are copies of the process of the command, which has no other threads."""
    names = [*(f"{number}.yaml" for number in range(24)), "bad.yaml", "nowhere.yaml"]
    for number, name in enumerate(names[:-2]):
        text = GOOD.replace("width: 0.9 m", f"width: 1.{number:02} m")
        Path(name).write_text(text, encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-X", "dev", "-W", "error", "-m", "thorvaldc", "check", *names],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    monkeypatch.setattr(file_commands, "FILES_OF_PROCESSES", 1000)
    assert result.stdout == thorvaldc("check", *names).out
    assert (result.returncode, result.stderr) == (1, "")


def test_the_files_share_no_diagnostics(thorvaldc: Command, files: list[str]) -> None:
    """Values of the library and buses that are computed once report their problems each time."""
    for name in ("first", "second"):
        Path(f"{name}.yaml").write_text(BAD, encoding="utf-8")
        Path(f"{name}.own.yaml").write_bytes(Path("own/robot.yaml").read_bytes())
    many = ["first.yaml", "second.yaml", "own/robot.yaml"]
    for checked in check_files(many, CHECK):
        assert list(checked.report) == list(CHECK(checked.file).report)
        assert checked.report.has_errors


def test_a_process_that_is_killed_loses_no_file(
    thorvaldc: Command, files: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(files: list[str], check: Check) -> Iterator[CheckedFile]:
        yield check(files[0])
        raise BrokenProcessPool("a process was terminated abruptly")

    alone = [list(CHECK(file).report) for file in files]
    monkeypatch.setattr(file_commands, "_of_processes", broken)
    results = list(check_files(files, CHECK))
    assert [result.file for result in results] == files
    assert [list(result.report) for result in results] == alone


def test_ctrl_c_ends_all_processes(thorvaldc: Command) -> None:
    names = [f"{number}.yaml" for number in range(400)]
    for name in names:
        Path(name).write_text(GOOD, encoding="utf-8")
    process = ChildProcess(
        [sys.executable, "-m", "thorvaldc", "check", *names],
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith("0.yaml: good")
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (130, "interrupted\n")
    end = time.monotonic() + 300.0
    while time.monotonic() < end:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError("a process goes on")
