"""``teleop`` on a pseudo-terminal, and ``call`` beside it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import termios
import threading
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD, SLOW, Command
from tests.cli.person import PATIENCE, Person
from tests.slow import mostly_slow
from tests.tools.teleoperation.test_joystick import Device
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.runtime.control_channel import ControlClient
from thorvaldc.tools.teleoperation.joystick import ABS_Y, BTN_TL


def at_teleop(folder: Path, *arguments: str) -> Person:
    return Person(folder, "teleop", *arguments)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "good.yaml").write_text(GOOD)
    with tempfile.TemporaryDirectory(prefix="tv") as sockets:
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        yield tmp_path


@pytest.fixture
def teleop(folder: Path) -> Iterator[Person]:
    running = at_teleop(folder, "good.yaml", "--on", "ideal")
    running.until("drives: nobody")
    yield running
    running.close()


def state(thorvaldc: Command, name: str = "good") -> dict[str, Any]:
    result = thorvaldc("call", name, "state", "--json")
    assert result.status == 0, result.err
    values = json.loads(result.out)
    assert isinstance(values, dict)
    return values


@pytest.mark.slow
def test_keys_drive_and_a_service_is_called_beside(
    teleop: Person, thorvaldc: Command, folder: Path
) -> None:
    teleop.type("9")
    teleop.until("drives: teleop_joy", typing="i")
    teleop.until("x 1.", typing="i")
    assert state(thorvaldc)["pose"]["x"] >= 1.0
    assert thorvaldc("call", "good", "safety-stop").status == 0
    teleop.until("locked: safety_stop")
    assert state(thorvaldc)["locks"] == ["safety_stop"]
    assert thorvaldc("call", "good", "reset_odometry").status == 0
    refused = thorvaldc("call", "good", "lock", "name=safety_stop", "locked=yes")
    assert (refused.status, refused.err) == (
        1,
        "error: `locked` is 'yes'; it must be true or false\n",
    )
    released = thorvaldc("call", "good", "release_safety_stop")
    assert released.status == 1
    assert ", which has ended; release it with `force=true` (in JSON" in released.err
    assert thorvaldc("call", "good", "release_safety_stop", "force=true").status == 0
    driven = thorvaldc("call", "good", "twist", "source=auto_nav", "vx=0.3")
    assert driven.status == 2
    assert "thorvaldc teleop --to good" in driven.err
    listed = thorvaldc("call", "good").out
    assert "twist source=... [vx=...] [vy=...] [wz=...]\n" in listed
    assert "pose: x " in thorvaldc("call", "good", "state").out
    second_teleop = thorvaldc("teleop", "good.yaml")
    assert second_teleop.status == 3  # and it has no terminal here
    teleop.type("q")
    assert teleop.end() == 0
    assert thorvaldc("call", "good", "state").status == 3


@pytest.mark.parametrize("way", mostly_slow(["hang-up", "ctrl-c", "terminate"], slow=1))
def test_the_terminal_is_restored(teleop: Person, way: str) -> None:
    teleop.type("i")
    teleop.until("drives: teleop_joy")
    if way == "ctrl-c":
        teleop.type("\x03")
    else:
        teleop.process.send_signal(signal.SIGTERM if way == "terminate" else signal.SIGHUP)
    assert teleop.end() == 0
    assert "Traceback" not in teleop.shown


@pytest.mark.slow
def test_two_operators_drive_one_robot(teleop: Person, folder: Path, thorvaldc: Command) -> None:
    other_person = at_teleop(folder, "--to", "good", "--source", "auto_nav", "--speed", "100")
    try:
        other_person.until("drives: nobody")
        other_person.until("drives: auto_nav", typing="j")
        other_person.type("j")
        assert state(thorvaldc)["asked"]["wz"] > 0.5
        teleop.read()  # its terminal may be full of what was shown before
        for _ in range(3):
            other_person.type("j")
            teleop.read()
        teleop.until("drives: auto_nav")
        teleop.type("q")
        teleop.end()
        limit = time.monotonic() + PATIENCE
        while other_person.process.poll() is None and time.monotonic() < limit:
            other_person.read()
        assert other_person.end() == 3
        assert "error: the driver `good` has ended" in other_person.shown
    finally:
        other_person.close()


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        ((), 2, "name a robot's FILE"),
        (("good.yaml", "--to", "x"), 2, "name a robot's FILE"),
        (("good.yaml", "--speed", "fast"), 2, "'fast' is not between 5 and 100 %"),
        (("good.yaml", "--speed", "120"), 2, "'120' is not between 5 and 100 % of the top speed"),
        (("good.yaml",), 3, "the keyboard needs a terminal"),
    ],
)
def test_wrong_options(
    thorvaldc: Command, arguments: tuple[str, ...], status: int, expected: str
) -> None:
    result = thorvaldc("teleop", *arguments)
    assert result.status == status
    assert expected in " ".join(result.err.replace("│", " ").split())


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (("--on", "sky"), 2, "'sky' is none of sim, ideal, virtual"),
        (("--source", "me"), 2, "it has teleop_joy, auto_nav"),
    ],
)
def test_wrong_options_on_a_terminal(
    folder: Path, arguments: tuple[str, ...], status: int, expected: str
) -> None:
    running = at_teleop(folder, "good.yaml", *arguments)
    try:
        running.process.wait(PATIENCE)
        running.read()
        assert running.process.returncode == status
        assert expected in " ".join(running.shown.replace("│", " ").split())
        assert termios.tcgetattr(running.command_end) == running.settings_before
    finally:
        running.close()


def test_call_without_a_driver(folder: Path, thorvaldc: Command) -> None:
    result = thorvaldc("call", "nobody", "state")
    assert result.status == 3
    assert "runs: start one with `thorvaldc run`" in result.err
    assert result.err.count("\n") == 1
    assert thorvaldc("call", "nobody", "state", "novalue").status == 2


@pytest.mark.slow
def test_teleop_drives_the_robot_of_run(folder: Path, thorvaldc: Command) -> None:
    (folder / "good.yaml").write_text(GOOD + SLOW)
    command = [sys.executable, "-m", "thorvaldc", "run", "good.yaml", "--bus", "virtual"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with ChildProcess(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        limit = time.monotonic() + PATIENCE
        ready = False
        while not ready and time.monotonic() < limit:
            time.sleep(0.05)
            answer = thorvaldc("call", "good", "state", "--json")
            ready = answer.status == 0 and json.loads(answer.out)["supervisor"] == "standby"
        assert ready
        person = at_teleop(folder, "--to", "good")
        try:
            person.until("standby  drives: nobody  held: not homed")
            person.until("homing the steering; the robot is armed when it has ended", typing="g")
            person.until("ready  drives: nobody")
            person.until("active  drives: teleop_joy", typing="i")
            again = thorvaldc("run", "good.yaml", "--bus", "virtual")
            assert again.status == 3
            assert "already runs" in again.err
            assert "--name selects another name" in again.err
            assert thorvaldc("call", "good", "safety_stop").status == 0
            person.until("estop")
            refused = thorvaldc("call", "good", "reset_faults")
            assert refused.status == 1
            assert "release it first" in refused.err
            person.type("q")
            assert person.end() == 0
        finally:
            person.close()
            process.send_signal(signal.SIGTERM)
        _, expected = process.communicate(timeout=PATIENCE)
    assert b"Traceback" not in expected
    assert thorvaldc("call", "good", "state").status == 3


@pytest.mark.slow
def test_the_model_of_a_build_drives(folder: Path, thorvaldc: Command) -> None:
    assert thorvaldc("build", str(folder / "good.yaml"), "-o", str(folder / "out")).status == 0
    running = at_teleop(folder, "out/model.json")
    try:
        running.until("drives: teleop_joy", typing="i")
        running.type("q")
        assert running.end() == 0
    finally:
        running.close()


@pytest.mark.slow
def test_a_robot_on_a_virtual_bus(folder: Path) -> None:
    (folder / "good.yaml").write_text(GOOD + SLOW)
    running = at_teleop(folder, "good.yaml", "--on", "virtual", "--speed", "20")
    try:
        running.until("not homed; arming homes the steering")
        running.until("homing the steering; the robot is armed when it has ended", typing="g")
        running.until("ready  drives: nobody")
        running.until("active  drives: teleop_joy", typing="l")
        running.type("\x03")
        assert running.end() == 0
    finally:
        running.close()


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (("good.yaml", "--map", "enable=BTN_TL"), 2, "is for a --joystick"),
        (("good.yaml", "--joystick", "/dev/input/none"), 3, "/dev/input/none"),
    ],
)
def test_missing_joysticks(
    monkeypatch: pytest.MonkeyPatch,
    thorvaldc: Command,
    arguments: tuple[str, ...],
    status: int,
    expected: str,
) -> None:
    search = types.ModuleType("evdev")
    search.InputDevice = _no_device  # type: ignore[attr-defined]
    search.ecodes = types.SimpleNamespace(ecodes={})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "evdev", search)
    result = thorvaldc("teleop", *arguments)
    assert result.status == status
    assert expected in " ".join(result.err.replace("│", " ").split())


def _no_device(path: str) -> None:
    raise FileNotFoundError(path)


def test_without_evdev_one_line_names_the_package(
    monkeypatch: pytest.MonkeyPatch, thorvaldc: Command
) -> None:
    monkeypatch.setitem(sys.modules, "evdev", None)
    result = thorvaldc("teleop", "good.yaml", "--joystick", "auto")
    assert (result.status, result.err) == (
        3,
        f"error: a joystick needs the package evdev (Linux): {install_command('joystick')}\n",
    )


def test_a_joystick_drives_without_a_terminal(
    folder: Path, monkeypatch: pytest.MonkeyPatch, thorvaldc: Command
) -> None:
    """Standard input is no terminal; unplugging the joystick stops the robot."""
    pad = Device()
    pad.button(BTN_TL)
    pad.axis(ABS_Y, -32768)
    evdev = types.ModuleType("evdev")
    evdev.list_devices = lambda: ["/dev/input/event0"] * (not pad.unplugged)  # type: ignore[attr-defined]
    evdev.InputDevice = lambda path: pad  # type: ignore[attr-defined]
    evdev.ecodes = types.SimpleNamespace(ecodes={})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "evdev", evdev)
    speeds: list[float] = []

    def beside() -> None:
        try:
            wait_for(lambda client: client.call("state")["in_force"]["vx"] > 0.7)
            pad.unplugged = True
            wait_for(lambda client: client.call("state")["in_force"]["vx"] == 0.0)
            speeds.append(0.0)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=beside)
    thread.start()
    result = thorvaldc("teleop", "good.yaml", "--on", "ideal", "--joystick", "auto")
    thread.join()
    assert (result.status, result.err, speeds) == (0, "", [0.0])
    assert "Joystick: hold the left shoulder button" in result.out
    assert "A key drives" not in result.out


def wait_for(holds: Callable[[ControlClient], bool]) -> None:
    limit = time.monotonic() + PATIENCE
    while time.monotonic() < limit:
        with contextlib.suppress(OSError):
            client = ControlClient("good")
            try:
                if holds(client):
                    return
            finally:
                client.close()
        time.sleep(0.02)
    raise AssertionError("it does not come to that")
