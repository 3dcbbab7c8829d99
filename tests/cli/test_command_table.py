"""The command table: every row loads, is light, and its help fits the terminal."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.cli.conftest import Command
from thorvaldc.cli.command import all_commands
from thorvaldc.tool_folders import TOPICS

PATHS = [tuple(entry.name.split()) for entry in all_commands() if entry.target]
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
        "names = [name for name in sys.modules if name.startswith('thorvaldc.')]\n"
        "ends = ('_command', '_commands')\n"
        "print([n for n in names if '.cli.commands.' in n or n.endswith(ends)])\n"
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
    entries = [e for e in all_commands() if e.group == " ".join(group) and not e.hidden]
    output = thorvaldc(*group, "--help").out
    if not group:
        entries.sort(key=lambda entry: TOPICS.index(entry.topic))
    lines = output.partition("Commands:\n" if group else f"{TOPICS[0]}:\n")[2].splitlines()
    shown = {line.split()[0]: line for line in lines if line.startswith("  ")}
    assert list(shown) == [entry.word for entry in entries]
    for entry in entries:
        assert shown[entry.word].endswith(entry.help)
        assert len(shown[entry.word]) <= 80
