"""A command ends with its status and at most a few lines, whatever happens; see cli/exits.py."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.child_process import ChildProcess

# The command `targets` with another body.
SCRIPT = """
import sys, os, time
import thorvaldc.cli.file_commands as command
def targets(json: bool = False) -> int:
{body}
command.targets = targets
sys.argv = ["thorvaldc", "targets"]
from thorvaldc.cli.main import run
run()
"""


def start(body: str, **more: object) -> subprocess.Popen[str]:
    script = SCRIPT.format(body="\n".join("    " + line for line in body.splitlines()))
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | more
    return ChildProcess([sys.executable, "-c", script], **options)


def finish(body: str, **more: object) -> tuple[int, str, str]:
    process = start(body, **more)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def test_ctrl_c_is_one_line_and_130() -> None:
    process = start("print('started', flush=True)\ntime.sleep(30)")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (130, "interrupted\n")


def test_ctrl_c_that_a_package_converts_to_another_exception() -> None:
    process = start(
        "print('started', flush=True)\n"
        "try: time.sleep(30)\n"
        "except KeyboardInterrupt: raise ImportError('initialization failed')"
    )
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (130, "interrupted\n")


def test_a_reader_that_leaves_is_not_an_error() -> None:
    process = start("for i in range(100000): print('line', i)\nreturn 0")
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(300) == 141
    process.stderr.close()


def test_little_output_to_a_reader_that_never_read() -> None:
    read, write = os.pipe()
    process = start("time.sleep(0.3)\nprint('x')\nreturn 0", stdout=write)
    os.close(write)
    os.close(read)
    _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_behind_stdout_is_3_and_one_line() -> None:
    with open("/dev/full", "w") as full:
        status, _, err = finish("print('x')\nreturn 0", stdout=full)
    assert (status, err) == (3, "error: stdout: No space left on device\n")


def test_an_operating_system_error_is_3_and_one_line() -> None:
    status, out, err = finish("open('/nowhere/at/all')")
    assert (status, out) == (3, "")
    assert err == "error: /nowhere/at/all: No such file or directory\n"


def test_an_internal_error_is_reported_without_a_traceback() -> None:
    status, out, err = finish("raise KeyError('wheel')")
    assert (status, out) == (70, "")
    assert err.startswith("internal error: KeyError: 'wheel'\n")
    assert "please report it" in err
    assert "Traceback" not in err
    assert len(err.splitlines()) == 3


def test_a_variable_shows_the_traceback() -> None:
    environment = {**os.environ, "THORVALDC_TRACEBACK": "1"}
    status, _, err = finish("raise KeyError('wheel')", env=environment)
    assert status == 70
    assert "Traceback (most recent call last)" in err
    assert "in targets" in err


def test_an_endless_recursion_is_an_internal_error() -> None:
    status, _, err = finish("def f(): f()\nf()")
    assert status == 70
    assert len(err.splitlines()) == 3


def test_a_status_passes() -> None:
    assert finish("return 1") == (1, "", "")


def test_text_that_the_terminal_cannot_show() -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    status, out, _ = finish("print('Kjøretøy')\nreturn 0", env=environment)
    assert (status, out) == (0, "Kj\\xf8ret\\xf8y\n")


def test_closed_streams() -> None:
    body = "os.close(1)\nos.close(2)\nsys.stdout = sys.stderr = None\nprint('x')\nreturn 0"
    assert finish(body)[0] == 0


def test_a_second_ctrl_c_does_not_bring_a_traceback() -> None:
    process = start("print('started', flush=True)\ntime.sleep(30)")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=300)
    assert "Traceback" not in err
