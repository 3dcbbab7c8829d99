"""A test that hangs fails, and leaves no process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HANGING = """
import sys
from tests.child_process import ChildProcess

SLEEPER = [sys.executable, "-c", "import time; time.sleep(600)"]

def test_that_fails_while_a_process_runs():
    with ChildProcess(SLEEPER):
        assert False, "in the block"

def test_that_waits_for_ever():
    with ChildProcess(SLEEPER):
        pass
"""


@pytest.mark.slow
def test_a_test_that_hangs_fails_and_the_next_runs(tmp_path: Path) -> None:
    pytest.importorskip("pytest_timeout")
    (tmp_path / "test_hanging.py").write_text(HANGING)
    command = ["-m", "pytest", "-q", "-c", os.devnull, "--rootdir", ".", "-p", "no:cacheprovider"]
    result = subprocess.run(
        [sys.executable, *command, "test_hanging.py"],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(Path(__file__).parents[1]),
            "PYTEST_TIMEOUT": "5",
        },
        # The pipes end with the last process that holds them: a process that is left fails here.
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert "2 failed" in result.stdout, result.stdout
    assert "in the block" in result.stdout
    assert "Timeout (>5.0s)" in result.stdout
