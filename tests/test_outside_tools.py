"""The list of outside programs is complete, and `.ci/run` can install it."""

from __future__ import annotations

import subprocess
import sys

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
