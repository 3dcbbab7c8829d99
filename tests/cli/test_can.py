"""`thorvaldc can scan|plan|flash|verify`, in virtual time and on a bus in another process."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.can.slcan_adapter import SlcanAdapter
from tests.child_process import ChildProcess
from tests.cli.conftest import Command
from tests.cli.test_bus import ROOT, running
from tests.simulation.bus.robots import CIA402, compiled
from thorvaldc.can.open_interface import bus_lock
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.commissioning.bus_configuration import digest
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

ONE = """
thorvaldc: 1
name: one_drive
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, params:
    {controller: controller/cia402_propulsion_steering}, can: {id: 1, serial: "0x101"}}
  fr: {type: caster/swivel, mount: frame.front_right}
  rl: {type: caster/fixed, mount: frame.rear_left}
  rr: {type: caster/fixed, mount: frame.rear_right}
"""
FRONT_RIGHT = """fr: {type: assembly/steered_drive, mount: frame.front_right, params:
    {controller: controller/cia402_propulsion_steering}, can: {bus: right, id: 2}}"""
NEW = ("robot.yaml", "--bus", "virtual:delivered", "--store", "memory.json")


@pytest.fixture
def robot(thorvaldc: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "robot.yaml"
    path.write_text(CIA402, encoding="utf-8")
    return path


@pytest.mark.slow
def test_from_new_drives_to_a_verified_robot_and_back(thorvaldc: Command, robot: Path) -> None:
    scan = thorvaldc("can", "scan", *NEW, "--active")
    assert scan.status == 1
    assert scan.out.count("unconfigured") == 4
    plan = thorvaldc("can", "plan", *NEW)
    assert plan.status == 0
    assert "1     lss-serial  give fl_controller the id 1" in plan.out
    hash_ = plan.out.split()[-1]
    dry = thorvaldc("can", "flash", *NEW)
    assert (dry.status, dry.out) == (0, plan.out)
    assert "nothing was written" in dry.err
    assert not robot.with_name("robot.flash.jsonl").exists()
    result = thorvaldc("can", "flash", *NEW, "--apply", "--yes", "--plan", hash_)
    assert (result.status, result.out) == (0, "with_cia402: done, 8 steps\n")
    assert result.err.count(": verified") == 8
    verified = thorvaldc("can", "verify", *NEW, "--json")
    assert verified.status == 0
    assert json.loads(verified.out)["passed"]
    again = thorvaldc("can", "flash", *NEW, "--apply", "--yes", "--json")
    assert json.loads(again.out)["result"] == "nothing to do"
    other = thorvaldc("can", "flash", *NEW, "--apply", "--yes", "--plan", hash_)
    assert other.status == 1
    assert f"not {hash_}" in other.err  # although there is nothing to do
    undone = thorvaldc("can", "flash", *NEW, "--rollback", "--yes")
    assert (undone.status, undone.out) == (0, "with_cia402: undone, 8 steps\n")
    differs = thorvaldc("can", "verify", *NEW)
    assert differs.status == 1
    assert "8 differences" in differs.out


def test_the_model_of_a_build_is_sufficient(thorvaldc: Command, robot: Path) -> None:
    thorvaldc("build", "robot.yaml", "--target", "can")
    target = ("build/with_cia402/model.json", *NEW[1:])
    assert thorvaldc("can", "flash", *target, "--apply", "--yes").status == 0
    assert Path("with_cia402.flash.jsonl").exists(), "not in the build, which is replaced"
    assert thorvaldc("can", "verify", *NEW).status == 0, "the file itself says the same"
    undone = thorvaldc(
        "can", "flash", *NEW, "--rollback", "--yes", "--journal", "with_cia402.flash.jsonl"
    )
    assert undone.status == 0, undone.err


TWO_BUSES = ONE.replace("modules:", "buses: {left: {}, right: {}}\nmodules:", 1)


def test_one_bus_of_two_is_set_up(thorvaldc: Command, robot: Path) -> None:
    """Frames of the only node that waited for an acknowledge do not count as a second node."""
    text = TWO_BUSES.replace("fr: {type: caster/swivel, mount: frame.front_right}", FRONT_RIGHT)
    robot.write_text(text.replace("{id: 1,", "{bus: left, id: 1,"), encoding="utf-8")
    target = ("robot.yaml", "--bus", "left=virtual:delivered", "--store", "memory.json")
    assert thorvaldc("can", "flash", *target, "--apply", "--yes").status == 0
    verified = thorvaldc("can", "verify", *target)
    assert verified.status == 0, verified.out
    wrong = thorvaldc("can", "verify", "robot.yaml", "--bus", "lft=virtual")
    assert wrong.status == 2
    assert "no bus lft, but left, right; select one: left=virtual" in wrong.err
    none = thorvaldc("can", "verify", "robot.yaml", "--bus", "sim:x")
    assert "has the buses left, right; select one: left=sim:x" in none.err


def test_passive_scan(thorvaldc: Command, robot: Path) -> None:
    scan = thorvaldc("can", "scan", "robot.yaml", "--bus", "virtual", "--json")
    assert scan.status == 0
    nodes = json.loads(scan.out)["nodes"]
    assert {node["verdict"] for node in nodes} == {"ok"}


@pytest.mark.slow
def test_a_passive_scan_sends_no_frame_and_reports_what_it_hears(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "robot.yaml").write_text(ONE, encoding="utf-8")
    with running(tmp_path, "robot.yaml", "--channel", "quiet"):
        listener = SimulatedBusClient("quiet", "listener", 500_000, listen_only=True)
        try:
            scan = thorvaldc("can", "scan", "robot.yaml", "--bus", "sim:quiet", "--json")
            heard = received_ids(listener)
            thorvaldc("can", "scan", "robot.yaml", "--bus", "sim:quiet", "--active")
            requested = received_ids(listener)
        finally:
            listener.close()
    assert {node["verdict"] for node in json.loads(scan.out)["nodes"]} == {"ok"}
    assert 0x701 in heard
    assert heard <= {0x701, 0x081}, "only heartbeats and emergencies of the node"
    assert 0x601 in requested


def received_ids(client: SimulatedBusClient) -> set[int]:
    ids = set()
    while (frame := client.receive(0.2)) is not None:
        ids.add(frame.frame.id)
        if len(ids) > 20:
            break
    return ids


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (["flash", *NEW, "--apply"], 2, "needs a terminal to ask at, or --yes"),
        (["flash", *NEW, "--rollback"], 2, "'--rollback': needs a terminal"),
        (["flash", *NEW, "--apply", "--resume", "--yes"], 2, "one of them at a time"),
        (["flash", *NEW, "--plan", "0" * 64], 2, "needs --apply"),
        (["flash", *NEW, "--resume", "--yes"], 2, "there is no journal robot.flash.jsonl"),
        (["flash", *NEW, "--apply", "--yes", "--plan", "0" * 64], 1, "plan-changed"),
        (["flash", *NEW, "--apply", "--yes", "--journal", "no/where.jsonl"], 3, "cannot write"),
        (["flash", *NEW, "--apply", "--yes", "--journal", "robot.yaml"], 1, "TV867"),
        (["flash", *NEW, "--apply", "--yes", "--journal", "/dev/full"], 3, "it is a device"),
        (["scan", "robot.yaml", "--bus", "virtual:new"], 2, "neither virtual nor"),
        (["scan", "robot.yaml", "--bus", "sim:nobody"], 3, "TV875"),
        (["scan", "robot.yaml", "--bus", "socketcan:can77"], 3, "TV875"),
        (["scan", "robot.yaml", "--bus", "sim:x", "--store", "a"], 2, "for a simulated robot"),
        (["scan", "good.yaml", "--bus", "virtual", "--store", "robot.yaml"], 1, "robot.yaml:"),
    ],
)
def test_errors_are_a_few_lines(
    thorvaldc: Command, robot: Path, arguments: list[str], status: int, expected: str
) -> None:
    got = thorvaldc("can", *arguments)
    assert got.status == status, got
    assert expected in got.err
    assert "Traceback" not in got.err
    assert not Path("robot.flash.jsonl").exists()


def test_a_second_master_on_this_computer_is_refused(
    thorvaldc: Command, robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lock depends on neither the user's folders nor the spelling of the interface."""
    with bus_lock("sim:./a"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", f"{robot.parent}/other")
        for command in (("can", "scan", "--active"), ("can", "plan"), ("run",)):
            got = thorvaldc(*command, "robot.yaml", "--bus", "sim:././a")
            assert got.status == 3
            assert "TV870" in got.err
        listening = thorvaldc("can", "scan", "robot.yaml", "--bus", "sim:./a")
        assert "TV875" in listening.err, "no lock is needed, and there is no such bus"


@pytest.mark.slow
def test_on_the_bus_of_another_process(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In real time: flash, interrupt, resume, verify."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "robot.yaml").write_text(ONE, encoding="utf-8")
    target = ("robot.yaml", "--bus", "sim:bench")
    journal = tmp_path / "robot.flash.jsonl"
    with running(tmp_path, "robot.yaml", "--channel", "bench", "--delivered"):
        process = ChildProcess(
            [sys.executable, "-m", "thorvaldc", "can", "flash", *target, "--apply", "--yes"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        limit = time.monotonic() + 300.0
        while process.poll() is None and time.monotonic() < limit:
            if journal.exists() and journal.read_bytes().count(b'"begin"') == 2:
                break
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=300)
        assert (process.returncode, out) == (130, ""), err
        assert "continue with --resume" in err.lower()
        assert '"interrupted"' in journal.read_text().splitlines()[-1]
        refused = thorvaldc("can", "flash", *target, "--apply", "--yes")
        assert (refused.status, "TV866" in refused.err) == (1, True), refused.err
        result = thorvaldc("can", "flash", *target, "--resume", "--yes")
        assert result.status == 0, result.err
        verified = thorvaldc("can", "verify", *target)
        assert verified.status == 0, verified.out


@pytest.mark.slow
def test_through_a_serial_adapter(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """python-can's slcan over a pseudo-terminal; the warning for hardware is shown."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "robot.yaml").write_text(ONE, encoding="utf-8")
    simulated = SimulatedRobot(compiled(ONE), delivered=True)
    adapter = SlcanAdapter(simulated)
    simulated.power_on()
    process = ChildProcess(
        [
            *(sys.executable, "-m", "thorvaldc", "can", "flash", "robot.yaml"),
            *("--bus", f"slcan:{adapter.path}", "--apply", "--yes"),
        ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        adapter.serve(lambda: process.poll() is not None, 60.0)
        out, err = process.communicate(timeout=300)
    finally:
        process.kill()
        adapter.close()
    assert (process.returncode, out) == (0, "one_drive: done, 2 steps\n"), err
    assert "never tried on physical hardware" in err
    assert simulated.devices["fl_controller"].nonvolatile["node_id"] == 1


@pytest.mark.parametrize(
    ("memory", "expected"),
    [
        ("[]", "expected a mapping"),
        ('{"fl_controller": {"node_id": 256}}', "node_id"),
        ('{"fl_controller": {"bitrate": {}}}', "bitrate"),
        ('{"fl_controller": {"bitrate": 1000000000000}}', "bitrate"),
        ('{"fl_controller": {"parameters": 3}}', "parameters"),
        ('{"fl_controller": {"parameters": {"1017": 3}}}', "as in `1017.00`"),
        ('{"fl_controller": {"parameters": {"1017.00": 1e99}}}', "1e"),
        pytest.param("[" * 100_000, "TV114", id="too deep"),
    ],
)
def test_a_store_is_checked_like_a_document(
    thorvaldc: Command, robot: Path, memory: str, expected: str
) -> None:
    Path("memory.json").write_text(memory, encoding="utf-8")
    got = thorvaldc("can", "verify", "robot.yaml", "--bus", "virtual", "--store", "memory.json")
    assert got.status == 1, got
    assert "memory.json:1:" in got.err
    assert expected in got.err


def test_a_device_ignores_stored_values_that_an_entry_cannot_have(
    thorvaldc: Command, robot: Path
) -> None:
    """Object 1015.00 is a u16; the device uses its default 0."""
    stored = {"fl_controller": {"node_id": 1, "parameters": {"1015.00": 70_000}}}
    Path("memory.json").write_text(json.dumps(stored), encoding="utf-8")
    got = thorvaldc("can", "verify", "robot.yaml", "--bus", "virtual", "--store", "memory.json")
    assert got.status == 1, got
    inhibit_time = next(line for line in got.out.splitlines() if "1015:0" in line)
    assert inhibit_time.split()[-2:] == ["1000", "0"]


@pytest.mark.parametrize("kind", ["pipe", "device", "large"])
def test_a_journal_is_a_file_of_a_limited_size(
    thorvaldc: Command, robot: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    path = Path("flash.jsonl")
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path = Path("/dev/zero")
    else:
        monkeypatch.setattr("thorvaldc.commissioning.journal.MAX_BYTES", 1000)
        path.write_text("x" * 1001, encoding="utf-8")
    got = thorvaldc("can", "flash", *NEW, "--apply", "--yes", "--journal", str(path))
    assert got.status == (1 if kind == "large" else 3), got
    assert f"it is a {kind}" in got.err or "it has more than" in got.err


@pytest.mark.parametrize("record", ["run", "begin"])
def test_a_journal_with_values_of_wrong_types_is_refused(
    thorvaldc: Command, robot: Path, record: str
) -> None:
    """The chain and the hash of its plan are right: another program wrote the journal."""
    assert thorvaldc("can", "flash", *NEW, "--apply", "--yes").status == 0
    path = Path("robot.flash.jsonl")
    lines = path.read_text(encoding="utf-8").splitlines()
    number = next(
        i for i, line in enumerate(lines) if f'"record":"{record}"' in line and "unsigned" in line
    )
    changed = json.loads(lines[number])
    del changed["chain"]
    values = changed["plan"]["target"]["nodes"][0]["values"] if record == "run" else changed["old"]
    values[0]["index"] = "x" * 9
    if record == "run":
        changed["hash"] = digest(changed["plan"])
    text = json.dumps(changed, separators=(",", ":"))[:-1]
    lines[number] = f'{text},"chain":""}}'
    link = ""
    for i, line in enumerate(lines):
        text = line.rpartition(',"chain":"')[0]
        link = hashlib.sha256((link + text).encode()).hexdigest()[:32]
        lines[i] = f'{text},"chain":"{link}"}}'
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    got = thorvaldc("can", "flash", *NEW, "--rollback", "--yes")
    assert got.status == 1, got
    assert f"robot.flash.jsonl is not the journal of a flash: line {number + 1}" in got.err


@pytest.mark.parametrize("command", ["scan", "scan --active", "verify", "plan", "flash --apply"])
def test_the_devices_of_another_bus_of_the_robot_are_named(
    thorvaldc: Command, robot: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    text = TWO_BUSES.replace("fr: {type: caster/swivel, mount: frame.front_right}", FRONT_RIGHT)
    robot.write_text(text.replace("{id: 1,", "{bus: left, id: 1,"), encoding="utf-8")
    words = ("can", *command.split(), "robot.yaml", "--bus", "left=virtual")
    words += ("--yes",) if "flash" in command else ()
    named = "the devices of the bus `right` are on the bus `left`; are the two exchanged?"
    assert named not in thorvaldc(*words).err
    interface = SimulatedRobot.interface
    monkeypatch.setattr(SimulatedRobot, "interface", lambda s, _, **o: interface(s, "right", **o))
    result = thorvaldc(*words)
    assert result.status == 1
    assert named in " ".join(result.err.split())
