"""The command table: every row loads, is light, and its help fits the terminal."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.cli.conftest import Command
from thorvaldc.cli.app import COMMANDS
from thorvaldc.cli.command import CommandEntry, GroupEntry

PATHS = [
    path
    for entry in COMMANDS
    for path in (
        [(entry.name,)]
        if isinstance(entry, CommandEntry)
        else [(entry.name, command.name) for command in entry.commands]
    )
]
HEAVY = [
    "numpy",
    "trimesh",
    "xacro",
    "mujoco",
    "can",
    "rich",
    "pydantic",
    "scipy",
    "matplotlib",
    "jsonschema",
]
SCRIPT = f"""
import contextlib, io, sys
from thorvaldc.cli.main import run_command
for path in sys.argv[1:]:
    sys.argv = ["thorvaldc", *path.split(), "--help"]
    with contextlib.redirect_stdout(io.StringIO()):
        status = run_command()
    heavy = [name for name in {HEAVY!r} if name in sys.modules]
    assert status == 0 and not heavy, (path, status, heavy)
"""


def test_the_help_of_no_command_loads_a_heavy_package() -> None:
    subprocess.run(
        [sys.executable, "-c", SCRIPT, "", *(" ".join(path) for path in PATHS)],
        env={"PYTHONPATH": ":".join(sys.path)},
        check=True,
    )


def test_the_help_of_the_groups_loads_no_command() -> None:
    script = (
        "import contextlib, io, sys\n"
        "from thorvaldc.cli.main import run_command\n"
        "with contextlib.redirect_stdout(io.StringIO()):\n"
        "    for words in (['--help'], ['can', '--help'], ['modules', '--help']):\n"
        "        sys.argv = ['thorvaldc', *words]\n"
        "        run_command()\n"
        "print([name for name in sys.modules if name.startswith('thorvaldc.cli.commands.')])\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == "[]\n"


@pytest.mark.parametrize("group", [(), ("can",), ("modules",)])
def test_each_command_has_one_line_of_help(group: tuple[str, ...], thorvaldc: Command) -> None:
    entries = COMMANDS
    for entry in COMMANDS:
        if isinstance(entry, GroupEntry) and group == (entry.name,):
            entries = entry.commands
    output = thorvaldc(*group, "--help").out
    lines = output.partition("Commands:\n")[2].splitlines()
    visible = [entry for entry in entries if not entry.hidden]
    assert [line.split()[0] for line in lines] == [entry.name for entry in visible]
    for line, entry in zip(lines, visible, strict=True):
        assert line.endswith(entry.help)
        assert len(line) <= 80
