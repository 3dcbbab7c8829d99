"""Logs as scripts of scenarios: records, CSV files and ROS bags."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer as FirstWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model.scenario import Command
from thorvaldc.simulation.records.csv_record import CsvRecorder
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.scenario_run import ScenarioSimulation

SLIM = Path(__file__).resolve().parents[3] / "examples/4wd4ws_slim/robot.yaml"
HEAD = f"""thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: {SLIM}}}, other: {{robot: {SLIM}, xyz: [0, 5, 0]}}}}
duration: 2 s
"""
STORE = get_typestore(Stores.ROS2_HUMBLE)
Spoken = Sequence[tuple[float, float, float]]


def compiled(folder: Path, script: str) -> Compilation:
    path = folder / "scenario.yaml"
    path.write_text(HEAD + f"script: {script}\n", encoding="utf-8")
    return compile_file(path)


def commands(folder: Path, script: str) -> dict[str, tuple[Command, ...]]:
    compilation = compiled(folder, script)
    assert [(d.code.name, d.message) for d in compilation.report.errors] == []
    assert compilation.scenario is not None
    return dict(compilation.scenario.commands)


def error_of(folder: Path, script: str) -> tuple[str, str, str]:
    """Returns code, message and hint of the only error."""
    (diagnostic,) = compiled(folder, script).report.errors
    return diagnostic.code.name, diagnostic.message, diagnostic.hint or ""


def bag(path: Path, topics: dict[str, Spoken], *, stamped: bool = False, mcap: bool = True) -> Path:
    """Writes a ROS bag; each message is time (s), vx and wz."""
    types = STORE.types
    vector, time_ = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]
    kind = "geometry_msgs/msg/TwistStamped" if stamped else "geometry_msgs/msg/Twist"
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, spoken in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for seconds, vx, wz in spoken:
                message = types["geometry_msgs/msg/Twist"](
                    vector(vx, 0.0, 0.0), vector(0.0, 0.0, wz)
                )
                if stamped:
                    header = types["std_msgs/msg/Header"](time_(0, 0), "base_link")
                    message = types[kind](header, message)
                at = 1_700_000_000_000_000_000 + round(seconds * 1e9)
                writer.write(connection, at, STORE.serialize_cdr(message, kind))
    return path


DRIVE = [(k * 0.1, 0.5, 0.1) for k in range(6)]


def test_velocities_from_the_columns_of_a_csv_file(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text("time,wz,vx\n0,0,0.5\n0.1,0,0.5\n1.5,0.2,0.5\n2,0,0\n")
    commands_by_robot = commands(tmp_path, "{log: drive.csv}")
    expected = (
        Command(0.0, 0.5, 0.0, 0.0),
        Command(1.5, 0.5, 0.0, 0.2),
        Command(2.0, 0.0, 0.0, 0.0),
    )
    assert commands_by_robot == {"cart": expected, "other": expected}
    assert commands(tmp_path, "{log: drive.csv, robot: other}") == {"cart": (), "other": expected}


@pytest.mark.parametrize("start", [0, 3, 100, 1_764_442_000])
def test_times_of_a_csv_file_count_from_its_first_line(tmp_path: Path, start: int) -> None:
    """A part of a longer log, and times of day; the first line may command nothing."""
    (tmp_path / "drive.csv").write_text(
        f"time,vx\n{start},0\n{start + 1},0.25\n{start + 1.5},0.5\n{start + 4},0\n"
    )
    assert commands(tmp_path, "{log: drive.csv}")["cart"] == (
        Command(1.0, 0.25, 0.0, 0.0),
        Command(1.5, 0.5, 0.0, 0.0),
        Command(4.0, 0.0, 0.0, 0.0),
    )


def test_the_logs_of_several_robots_begin_together(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "cart.csv").write_text("time,vx\n102,0.5\n")
    (folder / "other.csv").write_text("time,vx\n100,0\n101,0.25\n")
    assert commands(tmp_path, "{log: logs}") == {
        "cart": (Command(2.0, 0.5, 0.0, 0.0),),
        "other": (Command(1.0, 0.25, 0.0, 0.0),),
    }


@pytest.mark.parametrize("record", ["records", "record.mcap"])
def test_replayed_record_is_bit_identical(tmp_path: Path, record: str) -> None:
    script = "[{at: 0.5, vx: 0.5}, {at: 1, vx: 0.3, wz: 0.4, robot: other}]"
    first = compiled(tmp_path, script)
    hashes = []
    for compilation in (first, None):
        compilation = compilation or compiled(tmp_path, f"{{log: {record}}}")
        assert compilation.scenario is not None, [d.message for d in compilation.report]
        files = emit(compilation.scenario.fleet, ["mjcf"], Report())
        run = ScenarioSimulation(compilation.scenario, files)
        kind = McapRecorder if record.endswith(".mcap") else CsvRecorder
        recorder = kind(
            tmp_path / f"new_{record}", [*run.robots.items()], compilation.scenario.record
        )
        hashes.append(run.play(Report(), [recorder]).hash)
        recorder.close()
        if compilation is first:
            (tmp_path / f"new_{record}").rename(tmp_path / record)
    assert hashes[0] == hashes[1]


@pytest.mark.parametrize(
    ("stamped", "mcap"),
    [(True, True), (False, False), pytest.param(False, True, marks=pytest.mark.exhaustive)],
)
def test_each_robot_has_its_own_topic_in_a_bag(tmp_path: Path, stamped: bool, mcap: bool) -> None:
    topics = {"/cart/cmd_vel": DRIVE, "/other/cmd_vel": [(0.0, -0.2, 0.0)], "/joy": DRIVE}
    bag(tmp_path / "bag", topics, stamped=stamped, mcap=mcap)
    commands_by_robot = commands(tmp_path, "{log: bag}")
    assert commands_by_robot["cart"][0] == Command(0.0, 0.5, 0.0, 0.1)
    assert commands_by_robot["other"][0] == Command(0.0, -0.2, 0.0, 0.0)
    if mcap:
        assert commands(tmp_path, "{log: bag/bag.mcap}") == commands_by_robot
    chosen = commands(tmp_path, "{log: bag, topic: /joy, robot: other}")
    assert chosen == {"cart": (), "other": commands_by_robot["cart"]}


def test_ros_1_bags_are_read(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    kind, vector = "geometry_msgs/msg/Twist", store.types["geometry_msgs/msg/Vector3"]
    with FirstWriter(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/nav/cmd_vel", kind, typestore=store)
        for k in range(3):
            message = store.types[kind](vector(0.4, 0.0, 0.0), vector(0.0, 0.0, 0.2))
            writer.write(connection, k * 10**8, store.serialize_ros1(message, kind))
    commands_by_robot = commands(tmp_path, "{log: old.bag, robot: cart}")
    assert commands_by_robot["cart"][0] == Command(0.0, 0.4, 0.0, 0.2)


def test_twist_expires_after_the_command_timeout(tmp_path: Path) -> None:
    bag(tmp_path / "bag", {"/cmd_vel": [*DRIVE, (1.6, 0.5, 0.1), (1.7, 0.4, 0.0)]})
    compilation = compiled(tmp_path, "{log: bag}")
    assert compilation.scenario is not None
    timeout = compilation.scenario.fleet.placements[0].robot.driver.command_timeout
    assert 0.1 < timeout < 1.0
    commands_by_robot = dict(compilation.scenario.commands)["cart"]
    assert [(c.vx, c.wz) for c in commands_by_robot] == [
        (0.5, 0.1),
        (0, 0),
        (0.5, 0.1),
        (0.4, 0),
        (0, 0),
    ]
    times = [0.0, 0.5 + timeout, 1.6, 1.7, 1.7 + timeout]
    assert [c.time for c in commands_by_robot] == pytest.approx(times)


def test_logs_without_velocities_are_reported(tmp_path: Path) -> None:
    bag(tmp_path / "bag", {"/a": DRIVE, "/b": DRIVE})
    bag(tmp_path / "wild", {"/cmd_vel": [(0.0, float("nan"), 0.0)]})
    (tmp_path / "drive.csv").write_text("time,vx\n0,1\n")
    (tmp_path / "holes.csv").write_text("time,vx\n0,1\n1,\n")
    start = 1_764_449_485_123_456_789
    times = f"time,vx\n{start},0.5\n{start + 2_000_000_000},0\n"
    (tmp_path / "nanoseconds.csv").write_text(times)
    (tmp_path / "empty.csv").write_text("time,vx\n")
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "bag/bag.mcap").read_bytes()[:300])
    (tmp_path / "folder").mkdir()
    for script, code, message, hint in (
        ("{log: none.csv}", "script-log", "there is no file `none.csv`", ""),
        ("{log: bag, robot: cart}", "script-log", "2 topics with velocities", "it has /a, /b"),
        ("{log: bag, topic: /c}", "script-log", "does not exist", "it has /a, /b"),
        ("{log: wild, robot: cart}", "script-log", "is no number or above 1e+09", ""),
        ("{log: drive.csv, topic: /a}", "script-log", "not a ROS bag", ""),
        ("{log: holes.csv}", "script-log", "no velocity at 1 s", ""),
        ("{log: nanoseconds.csv}", "script-log", "lasts 2e+09 s", "write the times in s"),
        ("{log: empty.csv}", "script-log", "has no lines", ""),
        ("{log: folder, robot: cart}", "script-log", "no file cart.csv", ""),
        ("{log: cut.mcap}", "record-unreadable", "cannot be read as a ROS bag", "mcap recover"),
        ("{log: drive.csv, robot: car}", "scenario-robot-unknown", "no robot `car`", "`cart`"),
    ):
        error = error_of(tmp_path, script)
        assert error[0] == code, (script, error)
        assert message in error[1]
        assert hint in error[2]


def test_a_table_without_velocities_is_reported_at_its_heading(tmp_path: Path) -> None:
    (tmp_path / "still.csv").write_text("time,x\n0,1\n")
    (diagnostic,) = compiled(tmp_path, "{log: still.csv}").report.errors
    assert "no column `asked_vx`" in diagnostic.message
    span = diagnostic.span
    assert span is not None
    assert (span.line, span.column, span.end_line, span.end_column) == (1, 1, 1, 1)


def test_log_is_part_of_the_source_hash(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text("time,vx\n0,1\n")
    first = compiled(tmp_path, "{log: drive.csv}")
    (tmp_path / "drive.csv").write_text("time,vx\n0,0.9\n")
    assert compiled(tmp_path, "{log: drive.csv}").source_sha256 != first.source_sha256
    assert str(tmp_path / "drive.csv") in first.sources


def test_missing_rosbags_package_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag(tmp_path / "bag", {"/cmd_vel": DRIVE})
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    code, message, _ = error_of(tmp_path, "{log: bag, robot: cart}")
    assert code == "script-log"
    assert install_command("record") in message
