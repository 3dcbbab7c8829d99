"""Scenarios at the command line: exit statuses, reports, records."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from mcap.reader import make_reader

from tests.cli.conftest import Command
from thorvaldc.diagnostics.installation import install_command

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "examples/4wd4ws_slim/robot.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: short
robots: {{cart: {{robot: {ROBOT}}}}}
duration: 1 s
script: [{{at: 0, vx: 0.5 m/s}}]
expect: {{path: {{max: 1 m}}, collisions: {{max: 0}}}}
"""


def test_expectations_decide_the_status(thorvaldc: Command, tmp_path: Path) -> None:
    path, report = tmp_path / "s.yaml", tmp_path / "out.xml"
    path.write_text(SCENARIO)
    result = thorvaldc("scenario", str(path), "--junit", str(report))
    assert result.status == 0
    assert "short: 2 of 2 expectations met" in result.out
    assert ET.parse(report).getroot().get("failures") == "0"
    path.write_text(SCENARIO.replace("1 m}", "0.1 m}"))
    result = thorvaldc("scenario", str(path), "--junit", str(report), "--json")
    assert result.status == 1
    assert "s.yaml:6:10: error[TV820]" in result.err
    summary = json.loads(result.out)
    assert [(c["metric"], c["passed"]) for c in summary["checks"]] == [
        ("path", False),
        ("collisions", True),
    ]
    assert len(summary["hash"]) == 64
    suite = ET.parse(report).getroot().find("testsuite")
    assert suite is not None
    assert [len(case) for case in suite.iter("testcase")] == [0, 1, 0]


def test_another_robot_drives_the_scenario(thorvaldc: Command, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    other_robot = ROOT / "examples/6wd6ws/robot.yaml"
    result = thorvaldc(
        "scenario", str(path), "--robot", str(other_robot), "--record", str(tmp_path / "r")
    )
    assert result.status == 0
    assert "6: 6/6" in result.out
    assert (tmp_path / "r/cart.csv").read_text().startswith("time,odometry_x,")


def test_an_output_that_cannot_be_written_is_reported_before_the_run(
    thorvaldc: Command, tmp_path: Path
) -> None:
    path, existing_file = tmp_path / "s.yaml", tmp_path / "file"
    path.write_text(SCENARIO)
    existing_file.write_text("")
    for option, value in (("--record", existing_file), ("--junit", tmp_path / "none/out.xml")):
        result = thorvaldc("scenario", str(path), option, str(value))
        assert result.status == 3, option
        assert f"cannot write {value}" in result.err
        assert result.out == ""


def test_options_of_a_drive_are_refused_for_a_scenario(thorvaldc: Command, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    assert thorvaldc("sim", str(path), "--twist", "1,0,0").status == 2
    assert thorvaldc("scenario", str(ROBOT), "--junit", str(tmp_path / "a.xml")).status == 2
    assert thorvaldc("scenario", str(ROBOT), "--robot", str(ROBOT)).status == 2


def test_the_suffix_selects_the_format_of_the_record(thorvaldc: Command, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    for source in (path, ROBOT):
        seconds = [] if source == path else ["--twist", "0.5,0,0", "--duration", "1"]
        for name, starts, files in (
            ("a.mcap", b"\x89MCAP", "a.mcap, a.foxglove.json\n"),
            ("a.csv", b"time,", "a.csv\n"),
        ):
            result = thorvaldc("sim", str(source), *seconds, "--record", name)
            assert result.status == 0, result.err
            assert result.err == files
            assert Path(name).read_bytes().startswith(starts)
    result = thorvaldc("sim", str(path), "--record", "a.bag")
    assert result.status == 2
    assert "no record is a .bag file; name a .mcap or .csv file, or a folder" in result.err


@pytest.mark.slow
def test_fleets_have_logs_records_and_plots_of_every_robot(
    thorvaldc: Command, tmp_path: Path
) -> None:
    fleet = str(ROOT / "examples/fleet_of_four/fleet.yaml")
    short = ["--twist", "0.5,0,0", "--duration", "0.5"]
    result = thorvaldc("sim", fleet, *short, "--log", "logs", "--record", "r", "--plot", "p.png")
    assert result.status == 0, result.err
    names = ["six.csv", "slim.csv", "tall.csv", "wide.csv"]
    for folder, column in (("logs", ".position"), ("r", "odometry_x")):
        files = sorted((tmp_path / folder).iterdir())
        assert [file.name for file in files] == names
        for file in files:
            head, *rows = file.read_text().splitlines()
            assert column in head
            assert len(rows) == 26
    result = thorvaldc("sim", fleet, "--record", "all.csv")
    assert result.status == 2
    assert "4 robots do not go into one CSV file" in result.err


def test_without_rosbags_one_line_names_the_package(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    result = thorvaldc("sim", str(ROBOT), "--record", "a.mcap")
    assert result.status == 3
    assert result.out == ""
    assert install_command("record") in result.err


def test_sim_records_the_sensors_of_a_robot(thorvaldc: Command, tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    wide = str(ROOT / "examples/4wd4ws_wide/robot.yaml")
    options = ("--twist", "0.5,0,0", "--duration", "0.5")
    assert thorvaldc("sim", wide, *options, "--sensors", "--record", str(record)).status == 0
    with record.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = {
        channel.topic: summary.statistics.channel_message_counts[number]
        for number, channel in summary.channels.items()
    }
    assert counts["/imu/data"] == 51
    assert counts["/lidar_front/scan"] == 13


@pytest.mark.parametrize("record", [(), ("--record", "folder")])
def test_sensors_without_a_record_that_holds_them_are_refused(
    thorvaldc: Command, record: tuple[str, ...]
) -> None:
    result = thorvaldc("sim", str(ROBOT), "--sensors", *record)
    assert result.status == 2
    assert "needs a --record OUT.mcap" in result.err


def test_a_robot_without_sensors_says_so(thorvaldc: Command, tmp_path: Path) -> None:
    robot = str(ROOT / "examples/odrive/robot.yaml")
    record = str(tmp_path / "run.mcap")
    result = thorvaldc("sim", robot, "--duration", "0.2", "--sensors", "--record", record)
    assert result.status == 0
    assert "no robot has a sensor that is simulated" in result.err
