"""`thorvaldc bus`: a process that other programs attach to, and its end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import canopen
import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD, Command
from tests.simulation.bus.robots import CIA402
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.simulation.bus import python_can_plugin as interface

ROOT = Path(__file__).parents[2]


@contextmanager
def running(
    folder: Path, *arguments: str
) -> Iterator[tuple[subprocess.Popen[str], dict[str, object]]]:
    """Runs the command in a process; yields it with the description of its bus."""
    with started(folder, *arguments, "--json") as process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        assert line, process.stderr.read()
        yield process, json.loads(line)[0]


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Runs the command in a process."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(folder)}
    process = ChildProcess(
        [sys.executable, "-m", "thorvaldc", "bus", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def end(process: subprocess.Popen[str], number: int = signal.SIGINT) -> str:
    """Interrupts the process; returns its last messages."""
    process.send_signal(number)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    return err


@pytest.mark.slow
def test_canopen_attaches_and_ctrl_c_ends_it_cleanly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot.yaml").write_text(CIA402, encoding="utf-8")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    interface.register()
    store = tmp_path / "store.json"
    with running(tmp_path, "robot.yaml", "--store", "store.json") as (process, listing):
        assert listing["channel"] == "with_cia402"
        assert listing["bitrate"] == 500_000
        assert "fl_controller" in listing["devices"]  # type: ignore[operator]
        with canopen.Network() as network:
            network.connect(interface="thorvaldc_sim", channel=listing["channel"])
            node = network.add_node(3, canopen.ObjectDictionary())
            node.nmt.wait_for_heartbeat(5.0)
            node.sdo.RESPONSE_TIMEOUT = 2.0
            assert node.sdo.upload(0x1018, 4) == b"\x03\x01\0\0"
            network.lss.send_switch_state_selective(0, 402, 65536, 0x103)
            network.lss.configure_node_id(9)
            network.lss.store_configuration()
        sockets = list((tmp_path / "thorvaldc").iterdir())
        assert len(sockets) == 1
        assert "error frames" in end(process)
        assert list((tmp_path / "thorvaldc").iterdir()) == []
    assert json.loads(store.read_text(encoding="utf-8"))["rl_controller"]["node_id"] == 9
    with running(tmp_path, "robot.yaml", "--store", "store.json") as (process, listing):
        client = SimulatedBusClient(str(listing["channel"]))
        ids = set()
        while 0x709 not in ids:
            got = client.receive(5.0)
            assert got is not None
            ids.add(got.frame.id)
        client.close()
        end(process, signal.SIGTERM)


@pytest.mark.slow
def test_delivered_controllers_have_labels_that_they_keep(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(CIA402, encoding="utf-8")
    with running(tmp_path, "robot.yaml", "--delivered", "--store", "store.json") as (process, new):
        labels = new["labels"]
        assert labels["fl_controller"] == {  # type: ignore[index]
            "serial": "0x101",
            "motors": {"propulsion": "fl_drive_propulsion", "steering": "fl_steering_steering"},
        }
        end(process)
    file.write_text(CIA402.replace("0x101", "0x105"), encoding="utf-8")
    with running(tmp_path, "robot.yaml", "--store", "store.json") as (process, again):
        assert again["labels"] == labels
        end(process)
    with started(tmp_path, "robot.yaml", "--store", "store.json") as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("main: 7 devices")
        assert process.stdout.readline() == (
            "label of fl_controller: serial 0x101, wired to fl_drive_propulsion, "
            "fl_steering_steering\n"
        )
        end(process)


def test_injected_faults_are_reported_at_their_time(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(GOOD, encoding="utf-8")
    (tmp_path / "faults.yaml").write_text(
        "thorvaldc: 1\nfaults:\n"
        "  - {fault: power_cut, node: fl_controller, at: 50 ms, for: 50 ms}\n",
        encoding="utf-8",
    )
    with running(tmp_path, "robot.yaml", "--faults", "faults.yaml") as (process, _):
        assert process.stderr is not None
        assert process.stderr.readline() == "   0.050 s  simulated: power cut of fl_controller\n"
        assert (
            process.stderr.readline() == "   0.100 s  simulated: power cut of fl_controller ends\n"
        )
        end(process)


def test_mujoco_moves_the_motors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robot.yaml").write_text(GOOD, encoding="utf-8")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with running(tmp_path, "robot.yaml", "--physics", "mujoco", "--channel", "mine") as (
        process,
        listing,
    ):
        assert listing["channel"] == "mine"
        bus = interface.SimulatedBus("mine")
        bus.recv(1.0)
        bus.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
        bus.shutdown()
        end(process)


def test_a_channel_in_use_is_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robot.yaml").write_text(GOOD, encoding="utf-8")
    with running(tmp_path, "robot.yaml") as (process, _):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path)}
        second = subprocess.run(
            [sys.executable, "-m", "thorvaldc", "bus", "robot.yaml"],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert second.returncode == 3
        assert "already" in second.stderr
        assert len(second.stderr.splitlines()) == 1
        end(process)


def test_invalid_input_is_reported_before_the_bus_runs(thorvaldc: Command) -> None:
    drives = GOOD.partition("  battery:")[0]
    none = re.sub("can: [0-9]", "params: {controller: none}", drives)
    Path("none.yaml").write_text(none, encoding="utf-8")
    missing = thorvaldc("bus", "none.yaml")
    assert missing.status == 1
    assert "[TV850] bus-missing" in missing.err
    Path("faults.yaml").write_text(
        "thorvaldc: 1\nfaults: [{fault: mute, node: fl_controler, at: 1 s}]\n", encoding="utf-8"
    )
    wrong = thorvaldc("bus", "good.yaml", "--faults", "faults.yaml")
    assert wrong.status == 1
    assert "faults.yaml:2" in wrong.err
    assert "did you mean `fl_controller`" in wrong.err
    assert thorvaldc("bus", "good.yaml", "--faults", "nowhere.yaml").status == 1
    assert thorvaldc("bus", "bad.yaml").status == 1
    Path("store.json").write_text("[1]", encoding="utf-8")
    wrong_store = thorvaldc("bus", "good.yaml", "--store", "store.json")
    assert wrong_store.status == 1
    assert "store.json:1" in wrong_store.out + wrong_store.err
    for arguments in (("--physics", "real"), ("--seed", "x")):
        listing = thorvaldc("bus", "good.yaml", *arguments)
        assert listing.status == 2, listing
        assert "Traceback" not in listing.err
