"""Completion in shells: values of options and arguments, without the packages of the commands."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.cli.conftest import Command, needs_tools
from tests.cli.test_command_table import HEAVY
from tests.examples import FOLDER
from thorvaldc.cli.main import joined_words
from thorvaldc.runtime.control_channel import ControlServer
from thorvaldc.runtime.service_table import Services

PROGRAM = f"""\
#!{sys.executable}
import sys
sys.argv[0] = "thorvaldc"
from thorvaldc.cli.main import run
try:
    run()
finally:
    import os
    if "LOADED" in os.environ:
        with open(os.environ["LOADED"], "w") as file:
            print(*(n for n, m in sys.modules.items() if m is not None), file=file)
"""
CAR = FOLDER / "car" / "robot.yaml"
FIELD = FOLDER / "scenarios" / "field_edge.yaml"


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with the program ``thorvaldc``, which is first in PATH."""
    program = tmp_path / "bin" / "thorvaldc"
    program.parent.mkdir()
    program.write_text(PROGRAM)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", ":".join(sys.path))
    monkeypatch.chdir(tmp_path)
    with tempfile.TemporaryDirectory(prefix="tv") as sockets:  # paths of sockets are short
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        yield tmp_path


@cache
def completion_script() -> str:
    environment = {**os.environ, "_THORVALDC_COMPLETE": "source_bash"}
    program = shutil.which("thorvaldc")
    assert program is not None
    return subprocess.run(
        [sys.executable, program], env=environment, capture_output=True, text=True, check=True
    ).stdout


def bash(*words: str) -> list[str]:
    """The answers of a real bash to Tab at the end of the words, which are split as bash does."""
    quoted = " ".join(f"'{word}'" for word in words)
    script = (
        f"{completion_script()}\n"
        f"COMP_WORDS=({quoted}) COMP_CWORD={len(words) - 1}\n"
        "_thorvaldc_completion thorvaldc\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", script], capture_output=True, text=True, check=True, timeout=300
    )
    assert not done.stderr
    return done.stdout.split()


@needs_tools
def test_bash_completes_the_values_of_options_and_arguments(shell: Path) -> None:
    assert "urdf" in bash("thorvaldc", "build", "--target", "")
    assert "urdf,mjcf" in bash("thorvaldc", "build", "--target", "urdf,m")
    assert bash("thorvaldc", "modules", "show", "drive/st") == ["drive/standard"]


@pytest.mark.slow
@needs_tools
def test_each_kind_of_value_is_completed(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def answers(*words: str) -> list[str]:
        """Returns the answers to Tab of bash at the end of the words, from this process."""
        monkeypatch.setenv("_THORVALDC_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", "\n".join(["thorvaldc", *words]))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        result = thorvaldc()
        assert not result.err
        return result.out.split()

    assert "4wd4ws" in answers("new", "one", "--preset", "")
    assert answers("explain", "TV501") == ["TV501"]
    assert answers("explain", "can-id-dup") == ["can-id-duplicate"]
    assert "scenario" in answers("schema", "")
    assert answers("scenario", str(FIELD), "--set", "world.fri") == ["world.friction="]
    Path("deep.yaml").write_text("[" * 100_000 + "]" * 100_000)
    assert answers("scenario", "deep.yaml", "--set", "") == []
    assert answers("render", "robot.yaml", "--view", "r") == ["rear", "right"]
    assert "virtual" in answers("run", "robot.yaml", "--bus", "")
    assert answers("teleop", "robot.yaml", "--on", "id") == ["ideal"]
    assert {"mass", "wheels.", "size."} <= set(answers("why", str(CAR), ""))
    assert "wheels.fl_wheel." in answers("why", str(CAR), "wh")
    assert answers("why", "bad.yaml", "wh") == []


@needs_tools
def test_bash_completes_running_drivers_and_their_services(shell: Path) -> None:
    server = ControlServer("one_robot", Services([]))
    ended = threading.Event()

    def serve() -> None:
        while not ended.wait(0.01):
            server.poll(time.monotonic())

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert bash("thorvaldc", "call", "") == ["one_robot"]
        assert bash("thorvaldc", "teleop", "--to", "o") == ["one_robot"]
        assert bash("thorvaldc", "call", "one_robot", "ser") == ["services"]
    finally:
        ended.set()
        thread.join()
        server.close()


def test_bash_replaces_only_the_part_after_a_colon_or_an_equals_sign(shell: Path) -> None:
    folder = Path(os.environ["XDG_RUNTIME_DIR"]) / "thorvaldc"
    folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as running:
        running.bind(str(folder / "one_robot.sock"))
        running.listen()
        (folder / "killed.sock").touch()
        words = ("thorvaldc", "run", "robot.yaml", "--bus")
        assert bash(*words, "sim", ":", "one") == ["one_robot"]
        assert bash(*words, "sim", ":") == ["one_robot"]
        assert bash(*words, "main", "=", "sim", ":", "o") == ["one_robot"]
        assert bash("thorvaldc", "run", "robot.yaml", "--bus", "=", "si") == ["sim:one_robot"]


def test_words_of_bash() -> None:
    assert joined_words(["t", "--bus", "=", "sim", ":", "a"], 5) == (
        ["t", "--bus", "sim:a"],
        2,
        "sim:",
    )
    assert joined_words(["t", "call"], 2) == (["t", "call", ""], 2, "")


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        (
            {"_THORVALDC_COMPLETE": "complete_zsh", "_TYPER_COMPLETE_ARGS": "thorvaldc schema rob"},
            '"robot"',
        ),
        (
            {
                "_THORVALDC_COMPLETE": "complete_fish",
                "_TYPER_COMPLETE_ARGS": "thorvaldc schema rob",
                "_TYPER_COMPLETE_FISH_ACTION": "get-args",
            },
            "robot",
        ),
    ],
)
def test_zsh_and_fish(
    shell: Path, variables: dict[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    done = subprocess.run(
        [sys.executable, shell / "bin" / "thorvaldc"],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    ).stdout
    assert expected in done


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(("sim", "--"), marks=pytest.mark.exhaustive),
        ("faults", "--"),
        ("build", "--target", ""),
        pytest.param(("modules", "show", ""), marks=pytest.mark.exhaustive),
        ("scenario", str(FIELD), "--set", ""),
    ],
    ids="-".join,
)
def test_completion_loads_no_heavy_package(
    shell: Path, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOADED", str(shell / "loaded"))
    assert bash("thorvaldc", *words)
    loaded = set((shell / "loaded").read_text().split())
    assert "typer" in loaded
    assert not loaded.intersection([*HEAVY, "thorvaldc.compiler.pipeline", "thorvaldc.simulation"])
