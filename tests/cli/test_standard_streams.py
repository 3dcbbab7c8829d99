"""Commands whose standard streams are closed, full, or read by a program that has ended."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD
from tests.slow import mostly_slow

COMMANDS = (
    ("modules", "list"),
    ("--version",),
    ("sim", "good.yaml", "--twist", "0.3,0,0", "--duration", "0.1"),
    ("targets",),
    ("can", "plan", "good.yaml", "--bus", "virtual"),
)
each_command = pytest.mark.parametrize(
    "arguments", mostly_slow(COMMANDS, quick=2, slow=1), ids=" ".join
)
needs_full_device = pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="no /dev/full on this system"
)


def call(folder: Path, redirection: str, arguments: tuple[str, ...]) -> tuple[int, str, str]:
    """Returns the exit status, stdout and stderr of a command with a redirection of the shell."""
    program = [sys.executable, "-m", "thorvaldc", *arguments]
    process = ChildProcess(
        ["sh", "-c", f'exec "$@" {redirection}', "sh", *program],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "good.yaml").write_text(GOOD)
    return tmp_path


@each_command
def test_closed_streams_change_no_status(folder: Path, arguments: tuple[str, ...]) -> None:
    status, out, err = call(folder, "", arguments)
    assert status == 0
    assert call(folder, ">&-", arguments) == (0, "", err)
    closed = call(folder, "2>&-", arguments)
    assert closed[::2] == (0, "")
    assert closed[1].split()[:5] == out.split()[:5]  # later words are times of this run
    assert call(folder, "<&- >&- 2>&-", arguments) == (0, "", "")


@needs_full_device
@each_command
def test_a_full_disk_behind_stdout_is_named(folder: Path, arguments: tuple[str, ...]) -> None:
    status, _, err = call(folder, ">/dev/full", arguments)
    assert status == 3
    assert err.splitlines()[-1] == "error: stdout: No space left on device"
    assert "Traceback" not in err


@pytest.mark.slow
@needs_full_device
def test_messages_that_cannot_be_written_end_no_command(folder: Path) -> None:
    arguments = ("run", "good.yaml", "--bus", "virtual", "--twist", "0.3,0,0", "--duration", "0.5")
    status, out, _ = call(folder, "2>/dev/full", arguments)
    assert status == 0
    assert out


@each_command
def test_a_reader_that_has_ended(folder: Path, arguments: tuple[str, ...]) -> None:
    read, write = os.pipe()
    os.close(read)
    process = ChildProcess(
        [sys.executable, "-m", "thorvaldc", *arguments],
        cwd=folder,
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(write)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 141
    assert "rror" not in err


def test_a_file_does_not_get_the_descriptor_of_a_closed_stream(folder: Path) -> None:
    """What a library prints would be in the file."""
    script = (
        "import os, thorvaldc.cli.main as main\n"
        "def body():\n"
        "    with open('file', 'w') as file:\n"
        "        os.write(1, b'printed')\n"
        "        file.write('content')\n"
        "    return 0\n"
        "main.run_command = body\n"
        "main.run()\n"
    )
    process = ChildProcess(
        ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, "-c", script], cwd=folder
    )
    assert process.wait(timeout=300) == 0
    assert (folder / "file").read_text() == "content"


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_messages_are_written_at_once(unbuffered: str) -> None:
    script = (
        "import os, sys, thorvaldc.cli.main as main\n"
        "def body():\n"
        "    print('one', end=' ')\n"
        "    print('message', file=sys.stderr)\n"
        "    os.write(2, b'written later\\n')\n"
        "    return 0\n"
        "main.run_command = body\n"
        "main.run()\n"
    )
    process = ChildProcess(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        text=True,
    )
    out, _ = process.communicate(timeout=300)
    first, last = ("one ", "") if unbuffered else ("", "one ")
    assert out == f"{first}message\nwritten later\n{last}"


def test_a_connection_that_breaks_is_no_reader_that_has_ended(folder: Path) -> None:
    script = (
        "import thorvaldc.cli.file_commands as command\n"
        "def targets(json: bool = False) -> int:\n"
        "    raise BrokenPipeError(32, 'Broken pipe', 'control channel')\n"
        "command.targets = targets\n"
        "import sys; sys.argv = ['thorvaldc', 'targets']\n"
        "from thorvaldc.cli.main import run; run()\n"
    )
    process = ChildProcess([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True)
    _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (3, "error: control channel: Broken pipe\n")
