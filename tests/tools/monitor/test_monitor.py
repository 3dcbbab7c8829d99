"""``can monitor`` on a bus in another process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD, Command
from tests.cli.person import PATIENCE, Person
from tests.cli.test_bus import running
from tests.slow import mostly_slow


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "good.yaml").write_text(GOOD)
    with tempfile.TemporaryDirectory(prefix="tv") as sockets:
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        yield tmp_path


@pytest.fixture
def bus(folder: Path) -> Iterator[str]:
    """The channel of a running bus."""
    sockets = Path(os.environ["XDG_RUNTIME_DIR"])
    (sockets / "good.yaml").write_text(GOOD)
    with running(sockets, "good.yaml") as (_, listing):
        yield f"sim:{listing['channel']}"


@pytest.mark.slow
def test_json_lines_text_and_live_view(bus: str, folder: Path, thorvaldc: Command) -> None:
    watch = ("can", "monitor", "good.yaml", "--bus", bus)
    result = thorvaldc(*watch, "--duration", "1 s", "--interval", "250 ms", "--json")
    assert (result.status, result.err) == (0, "")
    summaries = [json.loads(line) for line in result.out.splitlines()]
    assert len(summaries) == 4
    assert {n["nmt"] for n in summaries[-1]["nodes"] if "controller" in n["name"]} == {
        "pre-operational"
    }
    assert 0.0 < summaries[-1]["load"] < summaries[-1]["load_budget"]
    assert not summaries[-1]["unknown"]

    result = thorvaldc(*watch, "--duration", "300 ms")
    assert result.status == 0
    assert result.out.startswith("good main  500 kbit/s  load ")
    assert "fl_controller_heartbeat" in result.out
    assert "\x1b" not in result.out


@pytest.mark.slow
def test_the_live_view_scrolls(bus: str, folder: Path) -> None:
    person = Person(folder, "can", "monitor", "good.yaml", "--bus", bus)
    try:
        person.until("\x1b[?1049h")
        person.resize(60, 20)
        person.until("good main")
        person.until("lines; arrow keys --")
        person.type("\x1b[B")
        person.until("-- 2 to ")
        person.until("state_of_health 100 %", typing="\x1b[B")  # whole, below the frame
        person.type("q")
        assert person.end() == 0
        assert "\x1b[?1049l" in person.shown
    finally:
        person.close()


@pytest.mark.parametrize("number", mostly_slow([signal.SIGINT, signal.SIGTERM], slow=0))
def test_a_signal_ends_the_monitor(bus: str, folder: Path, number: int) -> None:
    process = ChildProcess(
        [sys.executable, "-m", "thorvaldc", "can", "monitor", "good.yaml", "--bus", bus, "--json"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["robot"] == "good"
        process.send_signal(number)
        _, err = process.communicate(timeout=PATIENCE)
        assert (process.returncode, err) == (0, "")
    finally:
        process.kill()
        process.wait()


def test_a_reader_that_ends_is_no_lost_interface(bus: str, folder: Path) -> None:
    """As in ``thorvaldc can monitor --json | head``."""
    process = ChildProcess(
        [
            *(sys.executable, "-m", "thorvaldc", "can", "monitor", "good.yaml", "--bus", bus),
            *("--json", "--interval", "0.1"),
        ],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    assert json.loads(process.stdout.readline())["load"] >= 0.0
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(PATIENCE) == 141
    process.stderr.close()


@pytest.mark.slow
def test_a_bus_that_ends_is_3(folder: Path, thorvaldc: Command) -> None:
    sockets = Path(os.environ["XDG_RUNTIME_DIR"])
    (sockets / "good.yaml").write_text(GOOD)
    with running(sockets, "good.yaml") as (process, listing):
        person = Person(folder, "can", "monitor", "good.yaml", "--bus", f"sim:{listing['channel']}")
        try:
            person.until("good main")
            process.terminate()
            person.process.wait(PATIENCE)
            assert person.end() == 3
            assert "error: the CAN interface is lost" in person.shown
        finally:
            person.close()


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (("--bus", "sim:nobody"), 3, "no bus runs at"),
        (("--bus", "virtual"), 2, "a virtual bus exists only in its own process"),
        (("--bus", "left=sim:x"), 3, "`left=sim:x`"),
        (("--bus", "sim:x", "--duration", "soon"), 2, "'--duration'"),
        (("--bus", "sim:x", "--interval", "0"), 2, "not between 0.05 and 86400 s"),
        ((), 2, "Missing option '--bus'"),
    ],
)
def test_wrong_options(
    folder: Path, thorvaldc: Command, arguments: tuple[str, ...], status: int, expected: str
) -> None:
    result = thorvaldc("can", "monitor", "good.yaml", *arguments)
    assert result.status == status
    assert expected in " ".join(result.err.replace("│", " ").split())
