"""``sim`` of scenarios at the command line: statuses, reports, records."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tests.cli.conftest import Command

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "examples/4wd4ws_slim/robot.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: short
robots: {{cart: {{robot: {ROBOT}}}}}
duration: 1 s
script: [{{at: 0, vx: 0.5 m/s}}]
expect: {{path: {{max: 1 m}}, collisions: {{max: 0}}}}
"""


def test_what_is_met_and_what_is_not_decides(thorvaldc: Command, tmp_path: Path) -> None:
    path, report = tmp_path / "s.yaml", tmp_path / "out.xml"
    path.write_text(SCENARIO)
    done = thorvaldc("sim", str(path), "--junit", str(report))
    assert done.status == 0
    assert "short: 2 of 2 expectations met" in done.out
    assert ET.parse(report).getroot().get("failures") == "0"
    path.write_text(SCENARIO.replace("1 m}", "0.1 m}"))
    done = thorvaldc("sim", str(path), "--junit", str(report), "--json")
    assert done.status == 1
    assert "s.yaml:6:10: error[TV820]" in done.err
    result = json.loads(done.out)
    assert [(c["metric"], c["passed"]) for c in result["checks"]] == [
        ("path", False),
        ("collisions", True),
    ]
    assert len(result["hash"]) == 64
    suite = ET.parse(report).getroot().find("testsuite")
    assert suite is not None
    assert [len(case) for case in suite.iter("testcase")] == [0, 1, 0]


def test_another_robot_drives_it(thorvaldc: Command, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    other = ROOT / "examples/6wd6ws/robot.yaml"
    done = thorvaldc("sim", str(other), "--scenario", str(path), "--record", str(tmp_path / "r"))
    assert done.status == 0
    assert "6: 6/6" in done.out
    assert (tmp_path / "r/cart.csv").read_text().startswith("time,odometry_x,")


def test_what_cannot_be_written_is_known_before(thorvaldc: Command, tmp_path: Path) -> None:
    path, there = tmp_path / "s.yaml", tmp_path / "file"
    path.write_text(SCENARIO)
    there.write_text("")
    for option, value in (("--record", there), ("--junit", tmp_path / "none/out.xml")):
        done = thorvaldc("sim", str(path), option, str(value))
        assert done.status == 3, option
        assert f"cannot write {value}" in done.err
        assert done.out == ""


def test_options_of_one_twist_are_none_of_a_scenario(thorvaldc: Command, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    assert thorvaldc("sim", str(path), "--twist", "1,0,0").status == 2
    assert thorvaldc("sim", str(ROBOT), "--junit", str(tmp_path / "a.xml")).status == 2
    assert thorvaldc("sim", str(ROBOT), "--scenario", str(ROBOT)).status == 2


def test_what_is_recorded_is_chosen_by_the_name(thorvaldc: Command, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    for source in (path, ROBOT):
        seconds = [] if source == path else ["--twist", "0.5,0,0", "--duration", "1"]
        for name, starts in (("a.mcap", b"\x89MCAP"), ("a.csv", b"time,")):
            done = thorvaldc("sim", str(source), *seconds, "--record", name)
            assert done.status == 0, done.err
            assert done.err == f"{name}\n"
            assert Path(name).read_bytes().startswith(starts)
    done = thorvaldc("sim", str(path), "--record", "a.bag")
    assert done.status == 2
    assert "no record is a .bag file; name a .mcap or .csv file, or a folder" in done.err


def test_fleets_have_logs_records_and_plots_of_every_robot(
    thorvaldc: Command, tmp_path: Path
) -> None:
    fleet = str(ROOT / "examples/fleet_of_four/fleet.yaml")
    short = ["--twist", "0.5,0,0", "--duration", "0.5"]
    done = thorvaldc("sim", fleet, *short, "--log", "logs", "--record", "r", "--plot", "p.png")
    assert done.status == 0, done.err
    names = ["six.csv", "slim.csv", "tall.csv", "wide.csv"]
    for folder, column in (("logs", ".position"), ("r", "odometry_x")):
        files = sorted((tmp_path / folder).iterdir())
        assert [file.name for file in files] == names
        for file in files:
            head, *rows = file.read_text().splitlines()
            assert column in head
            assert len(rows) == 26
    done = thorvaldc("sim", fleet, "--record", "all.csv")
    assert done.status == 2
    assert "4 robots do not go into one CSV file" in done.err


def test_without_rosbags_one_line_says_what_to_install(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    done = thorvaldc("sim", str(ROBOT), "--record", "a.mcap")
    assert done.status == 3
    assert done.out == ""
    assert "pip install 'thorvaldc[record]'" in done.err
