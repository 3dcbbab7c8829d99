"""The commands of a designer need nothing that Windows and macOS lack.

They run in Python processes in which the code of thorvaldc finds none of it; what the standard
library itself needs on Linux stays.
"""

from __future__ import annotations

import json
import os
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from subprocess import DEVNULL, PIPE, CompletedProcess, run

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import needs_tools
from thorvaldc import backends

ROOT = Path(__file__).parents[2]
TALL = ROOT / "examples" / "4wd2ws_tall" / "robot.yaml"  # with a xacro file and meshes
FEWER = """
import asyncio.unix_events, builtins, os, signal, socket, sys

MISSING = "fcntl resource termios pwd grp tty pty readline curses syslog".split()
import_module = builtins.__import__

def import_portable(name, globals=None, *rest, **options):
    importer = str((globals or {}).get("__name__", ""))
    if name.split(".")[0] in MISSING and importer.startswith("thorvaldc"):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return import_module(name, globals, *rest, **options)

builtins.__import__ = import_portable
open_socket = socket.socket.__init__

def open_portable(self, family=-1, *rest, **options):
    if family == socket.AF_UNIX and sys._getframe(1).f_globals["__name__"].startswith("thorvaldc"):
        raise AttributeError("module 'socket' has no attribute 'AF_UNIX'")
    open_socket(self, family, *rest, **options)

socket.socket.__init__ = open_portable
loop = asyncio.AbstractEventLoop  # whose signal handlers are those of Windows: none
asyncio.unix_events._UnixSelectorEventLoop.add_signal_handler = loop.add_signal_handler
of_os = "getuid geteuid getgid killpg fork setsid getpgid mkfifo set_blocking fchmod"
of_os += " sched_getaffinity O_CLOEXEC O_NOCTTY O_NONBLOCK"
of_signal = "SIGHUP SIGQUIT SIGALRM setitimer pthread_sigmask"
for module, names in ((os, of_os), (signal, of_signal)):
    for name in names.split():
        delattr(module, name)
"""


@pytest.fixture
def variables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "sitecustomize.py").write_text(FEWER, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return {**os.environ, "PYTHONPATH": f"{tmp_path / 'system'}{os.pathsep}{ROOT}"}


@pytest.fixture
def call(variables: dict[str, str]) -> Callable[..., CompletedProcess[str]]:
    def call_command(*arguments: object) -> CompletedProcess[str]:
        command = [sys.executable, "-m", "thorvaldc", *map(str, arguments)]
        return run(
            command, env=variables, capture_output=True, text=True, check=False, stdin=DEVNULL
        )

    return call_command


ALL = """
import json, sys
from thorvaldc.cli.main import run_command
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["thorvaldc", *arguments]
    status = run_command()
    assert status == 0, (status, arguments)
"""


def test_the_modules_are_missing(variables: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "thorvaldc_of_linux.py").write_text("import fcntl\n")
    script = "import sys; sys.path.append('.'); import asyncio, thorvaldc_of_linux"
    done = run(
        [sys.executable, "-c", script], env=variables, capture_output=True, text=True, check=False
    )
    assert done.stderr.endswith("No module named 'fcntl'\n")


@pytest.mark.slow
@needs_tools
def test_a_designer_works_on_other_systems(variables: dict[str, str]) -> None:
    robot = "scout/robot.yaml"
    commands = (
        ("new", "scout"),
        ("new", "farm", "--project"),
        ("check", robot, TALL),
        ("build", TALL, "--target", ",".join(backends.names()), "-o", "built"),
        ("sim", robot, "--duration", "0.5"),
        ("scenario", "farm/scenarios/straight.yaml"),
        ("info", robot),
        ("diff", robot, "farm/robots/farm.yaml"),
        ("view", robot, "--html", "-o", "scout.html"),
        ("modules", "list"),
        ("schema", "robot"),
        ("explain", "TV408"),
    )
    words = json.dumps([[str(word) for word in command] for command in commands])
    command = [sys.executable, "-c", ALL, words]
    done = run(command, env=variables, capture_output=True, text=True, check=False, stdin=DEVNULL)
    assert done.returncode == 0, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    assert Path("built/urdf/robot.urdf").is_file()


@pytest.mark.slow
@needs_tools
def test_the_preview_and_the_language_server_on_other_systems(
    call: Callable[..., CompletedProcess[str]], variables: dict[str, str]
) -> None:
    assert call("new", "scout").returncode == 0
    command = [sys.executable, "-m", "thorvaldc"]
    preview = ChildProcess(
        [*command, "preview", "scout/robot.yaml", "--no-browser"],
        env=variables,
        stdout=PIPE,
        stderr=PIPE,
        text=True,
    )
    try:
        url = preview.stdout.readline().strip()
        assert url, preview.stderr.read()
        with urllib.request.urlopen(url, timeout=300) as page:
            assert b"<title" in page.read()
    finally:
        preview.end()
    request = json.dumps(
        {"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": {"capabilities": {}}}
    )
    message = f"Content-Length: {len(request)}\r\n\r\n{request}"
    done = run([*command, "lsp"], input=message, env=variables, capture_output=True, text=True)
    assert '"capabilities"' in done.stdout, done.stderr
