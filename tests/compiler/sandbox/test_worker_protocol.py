"""Tests of the limits of a worker process: its memory, and files with content."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from thorvaldc.compiler.sandbox.worker_protocol import set_limits
assert set_limits(1 << 30) == ""
try:
    bytearray(2 << 30)
except MemoryError:
    print("memory")
with open(sys.argv[1], "w") as file:
    file.write("x")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have fewer limits")
def test_a_limited_process_writes_no_content(tmp_path: Path) -> None:
    path = tmp_path / "new.txt"
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path)], capture_output=True, text=True
    )
    assert result.stdout == "memory\n"
    assert "File too large" in result.stderr
    assert path.read_bytes() == b""
