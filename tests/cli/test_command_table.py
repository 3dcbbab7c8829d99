"""The command table: every row loads, is light, and its help fits the terminal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from thorvaldc.cli.main import all_commands

ROOT = Path(__file__).parents[2]
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


# Rooms that a command does not use, in the order in which one process calls the commands.
UNUSED = {
    "modules list": ["thorvaldc.compiler.bus", "thorvaldc.compiler.hardware"],
    "check examples/4wd4ws_wide/robot.yaml": ["thorvaldc.model.fleet", "jsonschema"],
    "info examples/4wd4ws_wide/robot.yaml": ["thorvaldc.comparison"],
}
# In a copy of the core without its tools, `info` is not there.
COMMANDS = {entry.name.split()[0] for entry in all_commands()}
CALLED = {line: unused for line, unused in UNUSED.items() if line.split()[0] in COMMANDS}
UNUSED_SCRIPT = f"""
import contextlib, io, sys
from thorvaldc.cli.main import run_command
for line, unused in {CALLED!r}.items():
    sys.argv = ["thorvaldc", *line.split()]
    with contextlib.redirect_stdout(io.StringIO()):
        status = run_command()
    loaded = [name for name in unused if name in sys.modules]
    assert status == 0 and not loaded, (line, status, loaded)
"""


def test_a_command_loads_no_room_that_it_does_not_use() -> None:
    subprocess.run(
        [sys.executable, "-c", UNUSED_SCRIPT],
        cwd=ROOT,
        env={"PYTHONPATH": ":".join(sys.path)},
        check=True,
    )


def test_the_help_of_no_command_loads_a_heavy_package() -> None:
    subprocess.run(
        [sys.executable, "-c", SCRIPT, "", *(" ".join(path) for path in PATHS)],
        env={"PYTHONPATH": ":".join(sys.path)},
        check=True,
    )


@pytest.mark.parametrize("group", [(), ("can",), ("modules",)])
def test_each_command_has_one_line_of_help(group: tuple[str, ...], thorvaldc: Command) -> None:
    entries = [e for e in all_commands() if e.group == " ".join(group) and not e.hidden]
    output = thorvaldc(*group, "--help").out
    lines = output.partition("Commands:\n")[2].splitlines()
    shown = {line.split()[0]: line for line in lines if line.startswith("  ")}
    # typer lists the groups after the commands.
    entries.sort(key=lambda entry: not entry.target)
    assert list(shown) == [entry.word for entry in entries]
    for entry in entries:
        assert shown[entry.word].endswith(entry.help)
        assert len(shown[entry.word]) <= 80


PACKAGES = {"good": "def greet() -> int:\n    print('hello')\n    return 0\n", "broken": "1 / 0\n"}


def test_a_broken_command_of_another_package_is_left_out(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in PACKAGES.items():
        (tmp_path / f"{name}_package.py").write_text(text)
        info = tmp_path / f"{name}-1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
        entry = f"[thorvaldc.commands]\n{name} = {name}_package:greet\n"
        (info / "entry_points.txt").write_text(entry)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert thorvaldc("good")[:2] == (0, "hello\n")
    status, out, err = thorvaldc("broken")
    assert (status, out) == (2, "")
    assert "No such command 'broken'" in err
    warning = "warning: no command `broken` (broken_package:greet): ZeroDivisionError: division"
    assert err.startswith(warning)
    assert "  check " in thorvaldc("--help").out
