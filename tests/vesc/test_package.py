"""The example package: commands with and without it, and its frames in the CAN files."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cantools.database
import pytest

from tests.cli.conftest import needs_tools
from tests.example_packages import thorvaldc
from tests.examples import FOLDER, example_robot
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot

ROBOT = str(FOLDER / "vesc" / "robot.yaml")


def test_check_and_build_import_no_code_of_the_package(
    vesc_package: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    compilation = compile_file(Path(ROBOT))
    assert isinstance(compilation.model, Robot)
    assert not list(compilation.report)
    assert emit(compilation.model, ["urdf", "mjcf", "ros2", "can"])
    assert not [name for name in sys.modules if name.startswith("thorvaldc_vesc")]


def test_run_on_a_virtual_bus(tmp_path: Path, vesc_package: list[str]) -> None:
    arguments = ("--bus", "virtual", "--fast", "--twist", "0.5,0,0", "--duration", "3s", "--json")
    status, out, err = thorvaldc(tmp_path, vesc_package, "run", ROBOT, *arguments)
    assert (status, err) == (0, "")
    assert 1.2 < json.loads(out)["pose"]["x"] < 1.6


@needs_tools
def test_the_first_motion_is_checked(tmp_path: Path, vesc_package: list[str]) -> None:
    """The driver cannot read the timeout of a VESC, so the test of the first motion matters."""
    command = ("can", "commission", ROBOT, "--bus", "virtual", "--report", "first.json")
    status, out, err = thorvaldc(tmp_path, vesc_package, *command, "--json")
    assert status == 0, out + err
    motors = json.loads(out)["motors"]
    assert [motor["state"] for motor in motors] == ["passed", "passed"]


@needs_tools
@pytest.mark.slow
def test_the_faults_of_the_fault_table(tmp_path: Path, vesc_package: list[str]) -> None:
    only = ("--only", "of a drive", "--jobs", "2")
    status, out, _ = thorvaldc(tmp_path, vesc_package, "faults", ROBOT, *only)
    assert status == 0, out
    assert "All promises are kept." in out


def test_the_frames_in_the_can_files() -> None:
    """The frame of the page of the firmware: 51 A for the VESC ID 23 are 0x0117#0000C738."""
    files = emit(example_robot("vesc"), ["can"])
    database = cantools.database.load_string(files["can/robot.dbc"].decode("cp1252"), "dbc")
    command = database.get_message_by_name("right_controller_set_current")
    assert (command.frame_id, command.is_extended_frame) == (0x101, True)
    assert command.encode({"current": 51.0}).hex() == "0000c738"
    status = database.get_message_by_name("right_controller_status")
    assert (status.frame_id, status.is_extended_frame) == (0x901, True)
    assert {signal.byte_order for signal in status.signals} == {"big_endian"}
    header = files["can/robot_can.h"].decode()
    for line in (
        "MAIN_RIGHT_CONTROLLER_STATUS_COB_ID 0x901u",
        "MAIN_RIGHT_CONTROLLER_STATUS_EXTENDED 1u",
        "MAIN_RIGHT_CONTROLLER_STATUS_ERPM_BIG_ENDIAN 1u",
        "MAIN_RIGHT_CONTROLLER_STATUS_ERPM_START 7u",
    ):
        assert f"#define ROBOT_CAN_{line}" in header
    assert "BATTERY_STATUS_EXTENDED" not in header
    buses = json.loads(files["can/canmap.json"])["buses"]
    frames = {frame["name"]: frame for bus in buses for frame in bus["frames"]}
    assert frames["right_controller_status"]["extended"] is True
    assert frames["right_controller_status"]["signals"][0]["big_endian"] is True
    assert not any("extended" in f for name, f in frames.items() if name.startswith("battery"))
