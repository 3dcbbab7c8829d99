"""The rooms of the runtime wheel alone: commands that work, and one line from those that do not."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, needs_tools
from tests.cli.test_bus import running
from thorvaldc.compiler.pipeline import compile_file, emit

PACKAGE = Path(__file__).resolve().parents[2] / "thorvaldc"
ROOMS = ("runtime", "can", "commissioning", "model", "diagnostics", "cli")
pytestmark = needs_tools  # the distribution contains some
TOOLS = ("computer", "monitor", "service_calls", "teleoperation")
FILES = ("tools/__init__.py", "backends/__init__.py", "backends/computer.py")
MISSING = ("numpy", "mujoco", "yaml", "jsonschema")
# Runs the command where the packages of MISSING cannot be imported.
SCRIPT = f"""
import sys
for name in {MISSING!r}:
    sys.modules[name] = None
from thorvaldc.cli.main import run
sys.argv[0] = "thorvaldc"
run()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package ``thorvaldc`` of the runtime, good.yaml and its model.json."""
    folder = tmp_path_factory.mktemp("runtime")
    package = folder / "package/thorvaldc"
    ignore = shutil.ignore_patterns("__pycache__")
    for room in ROOMS:
        shutil.copytree(PACKAGE / room, package / room, ignore=ignore)
    for tool in TOOLS:
        shutil.copytree(PACKAGE / "tools" / tool, package / "tools" / tool, ignore=ignore)
    (package / "backends").mkdir()
    for file in ("__init__.py", "__main__.py", "tool_folders.py", *FILES):
        shutil.copy(PACKAGE / file, package / file)
    (folder / "good.yaml").write_text(GOOD, encoding="utf-8")
    model = compile_file(folder / "good.yaml").model
    assert model is not None
    (folder / "model.json").write_bytes(emit(model, [])["model.json"])
    return folder


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    sockets = str(folder)
    environment = {**os.environ, "PYTHONPATH": str(folder / "package"), "XDG_RUNTIME_DIR": sockets}
    return subprocess.run(
        [sys.executable, "-P", "-c", SCRIPT, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.parametrize(
    ("arguments", "feature"),
    [
        (["check", "good.yaml"], "`thorvaldc check`"),
        (["build", "good.yaml"], "`thorvaldc build`"),
        (["sim", "good.yaml"], "`thorvaldc sim`"),
        (["bus", "model.json"], "`thorvaldc bus`"),
        (["modules", "list"], "`thorvaldc modules list`"),
        (["targets"], "`thorvaldc targets`"),
        (["run", "model.json", "--bus", "virtual"], "`--bus virtual`"),
        (["can", "plan", "model.json", "--bus", "virtual"], "`--bus virtual`"),
    ],
)
def test_a_missing_command_is_3_and_one_line(
    folder: Path, arguments: list[str], feature: str
) -> None:
    result = call(folder, *arguments)
    assert (result.returncode, result.stdout) == (3, "")
    assert result.stderr == (
        f"error: {feature} is not available: this installation is the runtime alone; "
        "to replace it: `pip uninstall thorvaldc-runtime`, then `pip install` with the path of the"
        " wheel or the checkout of thorvaldc\n"
    )


def test_an_unknown_command_may_be_one_of_the_compiler_or_misspelt(folder: Path) -> None:
    result = call(folder, "view", "model.json")
    assert (result.returncode, result.stdout) == (2, "")
    *_, error, note = result.stderr.splitlines()
    assert error.startswith("Error: No such command 'view'.")
    assert note.startswith("note: this installation is the runtime alone; to replace it: `pip")
    result = call(folder, "telop", "model.json")
    assert (result.returncode, "Did you mean 'teleop'?" in result.stderr) == (2, True)
    result = call(folder, "can", "scan", "--nonsense")
    assert (result.returncode, "note:" in result.stderr) == (2, False)


def test_a_robot_file_needs_the_compiler(folder: Path) -> None:
    result = call(folder, "run", "good.yaml", "--bus", "udp")
    assert result.returncode == 3
    assert result.stderr.startswith("error: good.yaml needs the compiler")
    assert "give the model.json of a build" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_model_is_installed_without_a_compiler(folder: Path, tmp_path: Path) -> None:
    """The service drives the model as it is; a robot file needs the compiler."""
    root = ("--root", str(tmp_path))
    refused = call(folder, "install", "good.yaml", *root)
    assert (refused.returncode, "good.yaml needs the compiler" in refused.stderr) == (3, True)
    assert list(tmp_path.iterdir()) == []
    shutil.copy(folder / "model.json", folder / "my_robot.json")
    installed = call(folder, "install", "my_robot.json", *root)
    assert installed.returncode == 0, installed.stderr
    version = tmp_path / "etc/thorvaldc/good/versions/1"
    assert (version / "robot/model.json").read_bytes() == (folder / "model.json").read_bytes()
    unit = (version / "computer/systemd/thorvaldc-good.service").read_text(encoding="utf-8")
    assert "thorvaldc run /etc/thorvaldc/good/current/robot/model.json --bus socket" in unit
    assert " build " not in unit
    shown = call(folder, "status", *root)
    assert shown.stdout == "good: version 1\n  the base driver does not run\n"
    again = call(folder, "install", "model.json", *root)
    assert "nothing has changed" in again.stderr
    assert call(folder, "uninstall", "good", *root).returncode == 0


@pytest.mark.slow
def test_help_shows_the_commands_that_the_runtime_has(folder: Path) -> None:
    result = call(folder, "--help")
    assert result.returncode == 0
    commands = re.findall(r"^  ([a-z]+) ", result.stdout.split("Commands:")[1], re.MULTILINE)
    assert {"run", "can", "call", "teleop"} <= set(commands)
    for command in commands:
        assert call(folder, command, "--help").returncode == 0
    assert not {"check", "build", "sim", "modules"} & set(commands)


@pytest.mark.slow
def test_a_robot_on_a_simulated_bus_of_another_process(folder: Path) -> None:
    with running(folder, "good.yaml") as (_, listing):
        bus = ("model.json", "--bus", f"sim:{listing['channel']}")
        scan = call(folder, "can", "scan", *bus, "--active", "--json")
        assert scan.returncode == 0, scan.stderr
        assert {node["verdict"] for node in json.loads(scan.stdout)["nodes"]} == {"ok"}
        plan = call(folder, "can", "plan", *bus)
        assert plan.returncode == 0, plan.stderr
        monitor = call(folder, "can", "monitor", *bus, "--duration", "300 ms")
        assert monitor.returncode == 0, monitor.stderr
        assert monitor.stdout.startswith("good main")
        drive = call(folder, "run", *bus, "--twist", "0.4,0,0", "--duration", "1 s", "--json")
        assert json.loads(drive.stdout)["was_ready"], drive.stderr
