"""Commands with files that are no files, never end or are very large."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import Command, needs_tools

ROOT = Path(__file__).parents[2]
COMMANDS = {
    "check": ["check", "FILE"],
    "import": ["import", "FILE"],
    "calibrate": ["calibrate", "FILE", "good.yaml"],
    "log": ["check", "log.yaml"],
    "bag": ["check", "bag.yaml"],
    "faults": ["bus", "good.yaml", "--faults", "FILE"],
    "store": ["bus", "good.yaml", "--store", "FILE"],
    "mesh": ["check", "mesh.yaml"],
    "model": ["can", "plan", "model.json", "--bus", "virtual"],
}
MESH = """\
thorvaldc: 1
name: r
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  fl: {type: caster/fixed, mount: frame.front_left}
  fr: {type: caster/fixed, mount: frame.front_right}
  rear: {type: caster/fixed, mount: frame.rear_center}
extras: [{xacro: extra.urdf, parent: frame}]
"""
EXTRA = (
    '<robot name="x"><link name="top"><collision><geometry><mesh filename="FILE.stl"/></geometry>'
    "</collision></link></robot>"
)

SCENARIO = """\
thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: good.yaml}}}}
duration: 1 s
script: {{log: {}}}
"""


def command_line(name: str) -> tuple[list[str], Path]:
    """Returns the arguments of a command and the path of the file that it reads."""
    Path("mesh.yaml").write_text(MESH, encoding="utf-8")
    Path("extra.urdf").write_text(EXTRA, encoding="utf-8")
    Path("log.yaml").write_text(SCENARIO.format("FILE"), encoding="utf-8")
    Path("bag.yaml").write_text(SCENARIO.format("FILE.mcap"), encoding="utf-8")
    arguments = COMMANDS[name]
    file = {"mesh": "FILE.stl", "model": "model.json", "bag": "FILE.mcap"}
    return arguments, Path(file.get(name, "FILE"))


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_pipe_or_device_is_refused(thorvaldc: Command, name: str, kind: str) -> None:
    arguments, path = command_line(name)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    got = thorvaldc(*arguments)
    assert got.status == 1, got
    expected = f"it is a {kind}; expected a regular file"
    if name == "mesh":  # a link to another folder is refused for its place
        expected = "does not exist" if kind == "pipe" else "is outside of the"
    assert expected in got.err + got.out


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_is_refused(thorvaldc: Command, name: str) -> None:
    arguments, path = command_line(name)
    path.mkdir()
    got = thorvaldc(*arguments)
    assert got.status == 1, got
    assert "error[TV" in got.err + got.out


@pytest.mark.parametrize(
    "name", ["check", pytest.param("calibrate", marks=needs_tools), "mesh", "model"]
)
def test_a_large_file_needs_little_memory(thorvaldc: Command, name: str) -> None:
    """A file of 250 MB on one line: at most twice the file is in memory, and then not printed."""
    arguments, path = command_line(name)
    with path.open("wb") as file:
        file.truncate(250_000_000)
    # The memory of a process counts that of the process that starts it, before its program is
    # loaded; a small process in between is no test with all its modules.
    starts = "import resource as r, subprocess as s, sys\nstatus = s.call(sys.argv[1:])\nprint()\n"
    starts += "print(r.getrusage(r.RUSAGE_CHILDREN).ru_maxrss)\nsys.exit(status)"
    process = ChildProcess(
        [sys.executable, "-c", starts, sys.executable, "-m", "thorvaldc", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=-1,
        stderr=-2,
        text=True,
    )
    assert process.stdout is not None
    output = process.stdout.read()
    assert process.wait() == 1, output[:1000]
    assert len(output) < 10_000
    assert int(output.split()[-1]) < 900_000  # kB
