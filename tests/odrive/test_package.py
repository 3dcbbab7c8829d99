"""The example package beside thorvaldc: commands with and without it, other programs on its bus."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cantools.database
import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import SLOW, needs_tools
from tests.example_packages import environment, thorvaldc
from tests.examples import FOLDER, example_robot
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot, read_memory, write_memory

ROBOT = str(FOLDER / "odrive" / "robot.yaml")


def test_check_and_build_import_no_code_of_the_package(
    odrive_package: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    compilation = compile_file(Path(ROBOT))
    assert isinstance(compilation.model, Robot)
    assert not list(compilation.report)
    assert emit(compilation.model, ["urdf", "mjcf", "ros2", "can"])
    assert not [name for name in sys.modules if name.startswith("thorvaldc_odrive")]


def test_a_robot_file_cannot_name_code(tmp_path: Path) -> None:
    """A protocol is a name of an installed entry point, never a path to code."""
    modules = tmp_path / "modules" / "controller" / "odrive"
    modules.mkdir(parents=True)
    text = (FOLDER / "odrive/modules/controller/odrive/module.yaml").read_text(encoding="utf-8")
    modules.joinpath("module.yaml").write_text(
        text.replace(
            "protocol: odrive_cansimple", "protocol: thorvaldc_odrive.driver:OdriveController"
        )
    )
    (tmp_path / "robot.yaml").write_text(Path(ROBOT).read_text(encoding="utf-8"))
    compilation = compile_file(tmp_path / "robot.yaml")
    assert [d.code.name for d in compilation.report.errors] == ["bad-id"]


def test_without_the_package_the_driver_is_unknown(tmp_path: Path) -> None:
    status, _, err = thorvaldc(tmp_path, [], "run", ROBOT, "--bus", "virtual", "--duration", "1s")
    assert status == 1
    assert "TV876" in err
    assert "there is no driver for the protocol `odrive_cansimple` of `left_controller`" in err


def test_run_on_a_virtual_bus(tmp_path: Path, odrive_package: list[str]) -> None:
    arguments = ("--bus", "virtual", "--fast", "--twist", "0.5,0,0", "--duration", "3s", "--json")
    status, out, err = thorvaldc(tmp_path, odrive_package, "run", ROBOT, *arguments)
    assert (status, err) == (0, "")
    assert 1.2 < json.loads(out)["pose"]["x"] < 1.6


@needs_tools
def test_the_first_motion_is_checked(tmp_path: Path, odrive_package: list[str]) -> None:
    """The driver of a single motor needs nothing for it."""
    command = ("can", "commission", ROBOT, "--bus", "virtual", "--report", "first.json")
    status, out, err = thorvaldc(tmp_path, odrive_package, *command, "--json")
    assert status == 0, out + err
    motors = json.loads(out)["motors"]
    assert [motor["state"] for motor in motors] == ["passed", "passed"]
    names = {figure["name"] for motor in motors for figure in motor["figures"]}
    assert "drive's watchdog acts" in names


@needs_tools
@pytest.mark.slow
def test_the_faults_of_the_fault_table(tmp_path: Path, odrive_package: list[str]) -> None:
    only = ("--only", "a drive", "--jobs", "2")
    status, out, _ = thorvaldc(tmp_path, odrive_package, "faults", ROBOT, *only)
    assert status == 0, out
    assert "All promises are kept." in out
    killed = thorvaldc(tmp_path, odrive_package, "faults", ROBOT, "--only", "process killed")[1]
    assert "unlimited" in killed, "after the death of the driver the wheels coast"


@pytest.mark.slow
def test_two_processes(tmp_path: Path, odrive_package: list[str]) -> None:
    text = Path(ROBOT).read_text(encoding="utf-8") + SLOW
    robot = tmp_path / "robot.yaml"
    modules = FOLDER / "odrive" / "modules"
    robot.write_text(text.replace("library: [modules]", f"library: ['{modules}']"))
    command = [sys.executable, "-m", "thorvaldc", "bus", str(robot), "--json"]
    environ = environment(tmp_path, *odrive_package)
    bus = ChildProcess(command, env=environ, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert bus.stdout is not None
    assert json.loads(bus.stdout.readline())[0]["channel"] == "odrive_rover"
    on_bus = (str(robot), "--bus", "sim:odrive_rover")

    drive = ("run", *on_bus, "--twist", "0.3,0,0", "--duration", "3s", "--json")
    status, out, err = thorvaldc(tmp_path, odrive_package, *drive)
    assert status == 0, out + err
    assert json.loads(out)["pose"]["x"] > 0.1

    status, out, _ = thorvaldc(tmp_path, odrive_package, "can", "scan", *on_bus)
    assert status == 0
    assert out.count("ok ") == 3
    for arguments in (["scan", "--active"], ["plan"], ["flash"], ["verify"]):
        name, *options = arguments
        status, out, err = thorvaldc(tmp_path, odrive_package, "can", name, *on_bus, *options)
        assert status == 1, arguments
        assert "TV581" in err
        assert "left_controller (odrive_cansimple), right_controller (odrive_cansimple)" in err

    watch = ("can", "monitor", *on_bus, "--duration", "1.2s", "--json")
    status, out, _ = thorvaldc(tmp_path, odrive_package, *watch)
    frames = {frame["name"]: frame for frame in json.loads(out.splitlines()[-1])["frames"]}
    assert frames["left_controller_get_bus_voltage_current"]["values"]["bus_voltage"] == 24.0
    assert frames["left_controller_heartbeat"]["values"]["axis_state"] == "idle"
    assert frames["right_controller_get_encoder_estimates"]["problem"] == ""
    bus.end()


def test_the_memory_of_the_devices_reads_back(odrive_package: list[str], tmp_path: Path) -> None:
    """It has an id 0, a truth value and a time."""
    robot, path = example_robot("odrive"), tmp_path / "memory.json"
    simulated = SimulatedRobot(robot)
    write_memory(path, simulated)
    report = Report()
    assert read_memory(path, robot, report) == simulated.memory(), list(report)
    assert simulated.memory()["left_controller"]["motors"] == {"axis0": "left_drive_propulsion"}


def test_every_message_is_in_the_dbc() -> None:
    robot = example_robot("odrive")
    text = emit(robot, ["can"])["can/robot.dbc"].decode("cp1252")
    database = cantools.database.load_string(text, "dbc")
    commands = {m.frame_id & 0x1F for m in database.messages if m.frame_id >> 5 == 1}
    unused = {0x08, 0x0A, 0x10, 0x1E}
    assert commands == set(range(0x20)) - unused
    velocity = database.get_message_by_name("left_controller_set_input_vel")
    assert velocity.frame_id == 0x00D
    assert velocity.get_signal_by_name("input_vel").is_float


def test_a_controller_in_an_assembly_needs_no_channel_names(tmp_path: Path) -> None:
    """`assembly/fixed_drive` connects its motor to the first channel, whatever its name is."""
    text = Path(ROBOT).read_text(encoding="utf-8").replace(", params: {inverted: true}", "")
    text = text.replace("library: [modules]", f"library: ['{FOLDER / 'odrive' / 'modules'}']")
    parameters = "firmware: 0.6.11, watchdog_timeout_endpoint: 200, enable_watchdog_endpoint: 201"
    for side, node in (("left", 0), ("right", 1)):
        text = text.replace(
            f"mount: frame.front_{side}}}",
            f"mount: frame.front_{side}, can: {node}, params: {{controller: "
            f"{{type: controller/odrive, params: {{{parameters}}}}}}}}}",
        )
    omitted = ("_controller:", "  controller:", "defaults:")
    lines = [line for line in text.splitlines() if not any(key in line for key in omitted)]
    (tmp_path / "robot.yaml").write_text("\n".join(lines), encoding="utf-8")
    compilation = compile_file(tmp_path / "robot.yaml")
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    assert [a.channel for a in compilation.model.actuators] == ["axis0", "axis0"]
    assert [a.node for a in compilation.model.actuators] == ["left_controller", "right_controller"]
