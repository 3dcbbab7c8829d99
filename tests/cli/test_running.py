"""`thorvaldc run`: the driver on a virtual robot, over a socket, over a serial line."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from tests.can.slcan_adapter import SlcanAdapter
from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD, SLOW, Command, needs_tools
from tests.cli.test_bus import end, running
from thorvaldc import __version__
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime import control_channel
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

ROOT = Path(__file__).parents[2]
VIRTUAL = ("run", "good.yaml", "--bus", "virtual")


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "XDG_RUNTIME_DIR": str(folder),
        "XDG_STATE_HOME": str(folder / "state"),
    }
    return ChildProcess(
        [sys.executable, "-m", "thorvaldc", "run", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def states(summary: dict[str, Any]) -> list[str]:
    return [change["state"] for change in summary["changes"]]


# -- a virtual robot ------------------------------------------------------------------------------


def test_a_virtual_robot_drives_for_a_time(thorvaldc: Command) -> None:
    status, out, err = thorvaldc(
        *VIRTUAL, "--fast", "--duration", "3 s", "--twist", "0.5,0,0", "--json"
    )
    assert (status, err) == (0, "")
    summary = json.loads(out)
    assert 1.3 < summary["pose"]["x"] < 1.6
    started = ["init", "preop", "config", "standby", "homing", "ready", "active"]
    assert states(summary)[: len(started)] == started
    assert summary["state"] == "ready"
    assert summary["buses"]["main"]["not_sent"] == 0
    assert summary["timing"]["overruns"] == 0


def test_a_robot_with_physics_drives_as_far(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc(
        *VIRTUAL, "--fast", "--duration", "3 s", "--twist", "0.5,0,0", "--physics", "mujoco"
    )
    assert status == 0
    assert "ready" in out
    assert "  1.3 " in out or "  1.4 " in out


def test_inverted_motors_drive_the_same_path(thorvaldc: Command) -> None:
    turned = ", params: {inverted: true, steering_inverted: true}, can: 1}"
    Path("inverted.yaml").write_text(GOOD.replace(", can: 1}", turned, 1))
    run = ("--bus", "virtual", "--fast", "--duration", "3 s", "--twist", "0.4,0.1,0.2", "--json")
    poses = []
    for file in ("good.yaml", "inverted.yaml"):
        status, out, err = thorvaldc("run", file, *run)
        assert (status, err) == (0, "")
        poses.append(json.loads(out)["pose"])
    assert poses[1] == pytest.approx(poses[0], abs=1e-3)
    assert poses[0]["yaw"] > 0.3
    # The installer of the motors needs to see it.
    assert " inverted" in thorvaldc("info", "inverted.yaml").out
    assert " inverted" not in thorvaldc("info", "good.yaml").out


def test_changes_of_state_go_to_stderr(thorvaldc: Command) -> None:
    status, out, err = thorvaldc(*VIRTUAL, "--fast", "--duration", "1 s")
    assert status == 0
    assert len(out.splitlines()) == 1
    lines = [line.split() for line in err.splitlines()]
    assert [line[2] for line in lines] == ["init", "preop", "config", "standby"]


def test_the_model_of_a_build_is_sufficient(thorvaldc: Command) -> None:
    assert thorvaldc("build", "good.yaml", "-o", "out", "--target", "mjcf").status == 0
    Path("good.yaml").unlink()
    for more in ((), ("--physics", "mujoco")):
        model = ("run", "out/model.json", "--bus", "virtual", "--fast", "--duration", "1 s")
        assert thorvaldc(*model, *more).status == 0
    other = thorvaldc("run", "out/manifest.json", "--bus", "virtual")
    assert other.status == 1
    assert "out/manifest.json: not a thorvaldc-model file" in other.err
    Path("out/model.json").write_text("{}")
    status, _, err = thorvaldc("run", "out/model.json", "--bus", "virtual")
    assert status == 1
    assert "TV809" in err


FAULTS = """\
thorvaldc: 1
faults:
  - {fault: power_cut, node: fl_controller, at: 6 s}
"""


def test_a_fault_ends_an_unattended_run(thorvaldc: Command) -> None:
    Path("faults.yaml").write_text(FAULTS)
    status, out, err = thorvaldc(
        *VIRTUAL, "--fast", "--duration", "20 s", "--twist", "0.5,0,0", "--faults", "faults.yaml"
    )
    assert status == 3
    assert out.startswith("fault")
    assert "error[TV880] bus-stopped: fl_controller: no tpdo1 for" in err
    log = r"fault: fl_controller: no tpdo1 .* \(TV880 bus-stopped, see `thorvaldc explain TV880`\)"
    assert re.search(log, err)
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["good.yaml"], "--bus"),
        (["good.yaml", "--bus", "virtual", "--physics", "magic"], "neither ideal nor mujoco"),
        (["good.yaml", "--bus", "virtual", "--fast"], "needs a --duration"),
        (["good.yaml", "--bus", "virtual", "--duration", "1 m"], "'1 m'"),
        (["good.yaml", "--bus", "virtual", "--seed", "x"], "no whole number"),
        (["good.yaml", "--bus", "virtual", "--status-port", "65536"], "from 0 to 65535"),
        (
            ["good.yaml", "--bus", "virtual", "--status-port", "0", "--twist", "0,0,0"],
            "--name selects one",
        ),
        (["good.yaml", "--bus", "sim:x", "--seed", "1"], "for a simulated robot"),
        (["good.yaml", "--bus", "sim:x", "--physics", "mujoco"], "for a simulated robot"),
    ],
)
def test_usage(arguments: list[str], expected: str, thorvaldc: Command) -> None:
    status, out, err = thorvaldc("run", *arguments)
    assert (status, out) == (2, "")
    assert expected in err


@pytest.mark.parametrize(
    ("arguments", "status", "code"),
    [
        (["bad.yaml", "--bus", "virtual"], 1, "TV201"),
        (["good.yaml", "--bus", "virtual", "--parameters", "rail"], 1, "TV810"),
        (["good.yaml", "--bus", "socketkan:can0"], 3, "TV875"),
        (["good.yaml", "--bus", "slcan:/nowhere/port"], 3, "TV875"),
        (["good.yaml", "--bus", "sim:nobody"], 3, "TV875"),
        (["good.yaml", "--bus", "virtual:delivered"], 3, "TV875"),
        (["good.yaml", "--bus", "socketcan:can77"], 3, "TV875"),
    ],
)
def test_input_that_cannot_run(
    arguments: list[str], status: int, code: str, thorvaldc: Command
) -> None:
    summary = thorvaldc("run", *arguments)
    assert summary.status == status
    assert summary.out == ""
    assert f"error[{code}]" in summary.err
    if status == 3:
        assert len(summary.err.splitlines()) == 2  # and a hint


def test_an_empty_bus(thorvaldc: Command) -> None:
    """The driver ends within seconds on a python-can bus without devices."""
    status, out, err = thorvaldc("run", "good.yaml", "--bus", "virtual:empty", "--duration", "1 s")
    assert status == 3
    assert out.startswith("fault")
    assert "error[TV878] bus-start: no controller responds" in err


# -- by the clock, and by signals -----------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "number",
    [pytest.param(signal.SIGTERM, marks=pytest.mark.exhaustive), signal.SIGINT],
    ids=["SIGTERM", "SIGINT"],
)
def test_a_signal_stops_the_robot_and_disables_the_drives(number: int, tmp_path: Path) -> None:
    (tmp_path / "good.yaml").write_text(GOOD + SLOW)
    process = started(tmp_path, "good.yaml", "--bus", "virtual", "--twist", "0.5,0,0")
    assert process.stderr is not None
    for line in process.stderr:
        if "active" in line:
            break
    process.send_signal(number)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert out.startswith(("stopping", "ready")), out
    assert "Traceback" not in err


def test_a_status_port_in_use(thorvaldc: Command) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        status, out, err = thorvaldc(*VIRTUAL, "--status-port", port)
    assert (status, out) == (3, "")
    assert f"port {port} of 127.0.0.1 cannot be used" in err
    assert "--status-port names another one" in err


@pytest.mark.slow
def test_ctrl_c_ends_a_run_whose_page_has_a_client_that_hangs(tmp_path: Path) -> None:
    (tmp_path / "good.yaml").write_text(GOOD + SLOW)
    with tempfile.TemporaryDirectory(prefix="tv") as folder:  # a socket's path is short
        arguments = ("--bus", "virtual", "--name", f"{folder}/control", "--status-port", "0")
        process = started(tmp_path, "good.yaml", *arguments)
        assert process.stderr is not None
        address = process.stderr.readline()
        assert address.startswith("status page: http://127.0.0.1:")
        port = int(address.rpartition(":")[2].strip("/\n"))
        for line in process.stderr:
            if "standby" in line:
                break
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.sendall(b"GET / HT")
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does
            out, err = process.communicate(timeout=300)
    assert (process.returncode, "Traceback" in err) == (0, False)
    assert out.startswith("standby")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))


@pytest.mark.slow
@needs_tools
def test_a_driver_and_a_caller_of_different_versions_both_say_so(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    with tempfile.TemporaryDirectory(prefix="tv") as folder:  # a socket's path is short
        Path(folder, "good.yaml").write_text(GOOD + SLOW)
        process = started(Path(folder), "good.yaml", "--bus", "virtual")
        assert process.stderr is not None
        for line in process.stderr:
            if "standby" in line:
                break
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        equal = thorvaldc("call", "good", "description")
        assert (equal.status, equal.err) == (0, "")
        monkeypatch.setattr(control_channel, "program_version", lambda: "9.9.9")
        other = thorvaldc("call", "good", "description")
        assert (other.status, other.out) == (0, equal.out)
        assert other.err.startswith(
            f"warning: the driver `good` is thorvaldc {__version__}, this program is"
            " thorvaldc 9.9.9;"
        )
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    expected = f"is thorvaldc 9.9.9, this program is thorvaldc {__version__}; services and states"
    assert err.count("warning: connection ") == 1
    assert expected in err


def over_slcan(
    robot: Robot, folder: Path
) -> tuple[int, str, str, SlcanAdapter, dict[int, bytes], float]:
    """Runs the command on a serial line.

    Returns status, stdout, stderr, the adapter, frames by id, and the highest wheel speed.
    """
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    adapter = SlcanAdapter(simulated)
    frames_seen: dict[int, bytes] = {}
    simulated.wire().observers.append(
        lambda _, frame, __: frames_seen.update({frame.id: frame.data})
    )
    process = started(
        folder,
        *("good.yaml", "--bus", f"slcan:{adapter.path}", "--twist", "0.4,0,0"),
        *("--duration", "3 s", "--json"),
    )
    fastest, ended_at = 0.0, math.inf

    def over() -> bool:
        nonlocal fastest, ended_at
        for wheel in robot.wheels:
            actuator = robot.actuator_of(wheel.spin_joint)
            assert actuator is not None
            motor = simulated.motors[actuator.name]
            fastest = max(fastest, motor.read(simulated.timeline.seconds).velocity)
        if process.poll() is not None:
            ended_at = min(ended_at, time.monotonic())
        # The last frames of the driver wait in the serial line; then each node sends a heartbeat.
        return time.monotonic() > ended_at + 0.5

    adapter.serve(over, 60.0)
    simulated.run(0.2)  # the next heartbeats contain the last state
    out, err = process.communicate(timeout=300)
    adapter.close()
    return process.returncode, out, err, adapter, frames_seen, fastest


@pytest.mark.exhaustive  # test_runtime_only.py has this drive too
def test_over_a_bus_in_another_process(tmp_path: Path) -> None:
    (tmp_path / "good.yaml").write_text(GOOD + SLOW)
    with running(tmp_path, "good.yaml") as (bus, listing):
        process = started(
            tmp_path,
            *("good.yaml", "--bus", f"sim:{listing['channel']}", "--twist", "0.4,0,0"),
            *("--duration", "2 s", "--json"),
        )
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        summary = json.loads(out)
        assert summary["pose"]["x"] > 0.3
        assert "hardware" not in err
        end(bus)


@pytest.mark.slow
def test_a_late_process_of_the_bus_is_no_silent_node(tmp_path: Path) -> None:
    """SIGSTOP stops the bus for 120 ms, five times, and then for a second.

    On a busy computer, an earlier pause may end the drive, for the same reason, or since joint
    states are missing for a moment.
    """
    (tmp_path / "good.yaml").write_text(GOOD)
    with running(tmp_path, "good.yaml") as (bus, listing):
        drive = ("--bus", f"sim:{listing['channel']}", "--twist", "0.4,0,0")
        process = started(tmp_path, "good.yaml", *drive)
        assert process.stderr is not None
        lines = list[str]()
        for line in process.stderr:
            lines.append(line)
            if "active" in line:
                break
        for pause in (0.12, 0.12, 0.12, 0.12, 0.12, 1.0):
            bus.send_signal(signal.SIGSTOP)
            time.sleep(pause)
            bus.send_signal(signal.SIGCONT)
            time.sleep(0.5)
        err = "".join(lines) + process.communicate(timeout=300)[1]
        assert process.returncode == 3, err
        assert re.search(r"TV880.*(\bbus `main`.* too busy\?|no usable joint states)", err), err
        assert "silent" not in err
        end(bus)


@pytest.mark.slow
def test_a_stopped_process_is_a_gap_in_time(tmp_path: Path) -> None:
    """SIGSTOP stops the driver, and the bus in the other process goes on."""
    (tmp_path / "good.yaml").write_text(GOOD)
    with running(tmp_path, "good.yaml") as (bus, listing):
        channel = f"sim:{listing['channel']}"
        process = started(tmp_path, "good.yaml", "--bus", channel, "--twist", "0.4,0,0")
        assert process.stderr is not None
        for line in process.stderr:
            if "active" in line:
                break
        process.send_signal(signal.SIGSTOP)
        time.sleep(2.0)
        process.send_signal(signal.SIGCONT)
        _, err = process.communicate(timeout=300)
        assert process.returncode == 3, err
        assert re.search(r"TV880.*no control cycle for 2\d\d\d ms", err), err
        end(bus)


@pytest.mark.slow
def test_over_a_serial_line_from_another_process(tmp_path: Path) -> None:
    """slcan on a pair of pseudo-terminals carries all frames, and the wheels turn."""
    path = tmp_path / "good.yaml"
    path.write_text(GOOD + SLOW)
    robot = compile_file(path).model
    assert isinstance(robot, Robot)
    status, out, err, adapter, frames_seen, fastest = over_slcan(robot, tmp_path)
    assert status == 0, err
    summary = json.loads(out)
    assert "never tried on physical hardware" in err
    assert adapter.commands[:3] == ["C", "S6", "O"]
    assert fastest == pytest.approx(0.4 / 0.2, rel=0.02)
    assert 0.6 < summary["pose"]["x"] < 1.3
    planned = {f.cob_id for f in robot.buses[0].frames if f.period is not None}
    assert planned <= set(frames_seen)
    # After the run, all nodes are stopped or pre-operational again.
    assert all(frames_seen[0x700 + node.id] == b"\x7f" for node in robot.buses[0].nodes)


def test_the_warning_for_hardware_is_shown_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from thorvaldc.cli.robot_file import warn_once

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    warn_once()
    assert "never tried on physical hardware" in capsys.readouterr().err
    warn_once()
    assert capsys.readouterr().err == ""
