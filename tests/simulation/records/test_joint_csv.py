"""Joint logs: the reader returns what the writer wrote, and reports everything else."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.recording import record
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.simulation.records.joint_csv import JointLog, read_log

ROBOT = make_robot(
    [*FOUR_STEERED[:2], (-0.5, 0.4, "fixed"), (-0.5, -0.4, "passive"), (-0.7, 0, "swivel")]
)
DIFFERENTIAL = make_robot([(0.0, 0.4, "fixed"), (0.0, -0.4, "fixed"), (-0.5, 0.0, "swivel")])
HEADER = "time,w0_axle.position,w1_axle.velocity\n"


def read(
    text: str | bytes, path: Path, robot: Robot = DIFFERENTIAL
) -> tuple[JointLog | None, Report]:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    report = Report()
    return read_log(path, path.name, robot, report), report


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "joints.csv"


def test_a_written_log_is_read_back(path: Path) -> None:
    log, report = read(record(ROBOT, seconds=2.0), path, ROBOT)
    assert log is not None
    assert not len(report)
    assert log.times == pytest.approx([k / 50 for k in range(101)])
    assert list(log.positions) == ["w0_axle", "w1_axle", "w2_axle"]
    assert log.velocities == {}
    assert list(log.commands) == list(log.positions)
    assert list(log.angles) == ["w0_steering_axis", "w1_steering_axis"]
    speed = 0.8 / ROBOT.wheels[0].radius
    assert log.commands["w0_axle"][-1] == pytest.approx(speed)
    angles = log.positions["w0_axle"]
    assert angles[-1] - angles[-2] == pytest.approx(speed / 50, rel=1e-6)


def test_angles_are_encoder_readings(path: Path) -> None:
    offsets = {"w0_steering_axis": 0.1, "w1_steering_axis": -0.2}
    actuators = tuple(replace(a, encoder_offset=offsets.get(a.joint, 0.0)) for a in ROBOT.actuators)
    log, _ = read(record(replace(ROBOT, actuators=actuators), seconds=1.0), path, ROBOT)
    assert log is not None
    for joint, offset in offsets.items():
        assert log.angles[joint][-1] == pytest.approx(-offset, abs=1e-6)


def test_byte_order_mark_and_crlf_are_accepted(path: Path) -> None:
    text = "\ufeff" + HEADER + "0,0,1\n0.02,0.02,1\n\n"
    log, report = read(text.replace("\n", "\r\n"), path)
    assert log is not None
    assert not len(report)
    assert list(log.positions["w0_axle"]) == [0.0, 0.02]
    assert list(log.velocities["w1_axle"]) == [1.0, 1.0]
    assert log.commands == {}


def test_joints_without_a_motor_are_ignored(path: Path) -> None:
    text = "time,w2_axle.position,w0_axle.position,w1_axle.velocity\n0,9,0,1\n1e-2,9,0.02,1\n"
    assert read(text, path)[0] is not None


@pytest.mark.parametrize(
    ("text", "code", "line", "column"),
    [
        ("", "record-unreadable", 1, 1),
        ("time\n0\n", "record-unreadable", 1, 1),
        ("time,other.position\n0,0\n", "joint-log-joint", 1, 6),
        ("time,w0_axle.angle\n0,0\n", "joint-log-joint", 1, 6),
        (HEADER.replace("w1", "w0").replace("velocity", "position"), "record-unreadable", 1, 23),
        (HEADER + "0,0,1\n0.02,inf,1\n", "record-value", 3, 6),
        (HEADER + "0,0,1\n0.02,1e999,1\n", "record-value", 3, 6),
        (HEADER + "0,0,1\n0.02,1_0,1\n", "record-value", 3, 6),
        (HEADER + "0,0,1\n0.02,0,1,\n", "record-value", 3, 1),
        (HEADER + "0,0,1\nnan,0,1\n", "record-value", 3, 1),
        (HEADER + "0,0,1\n-1,0,1\n", "record-value", 3, 1),
        (b"time,\xff\n", "file-unreadable", 1, 1),
    ],
)
def test_errors_have_line_and_column(
    text: str | bytes, code: str, line: int, column: int, path: Path
) -> None:
    log, report = read(text, path)
    assert log is None
    first = report.errors[0]
    assert first.span is not None
    assert (first.code.name, first.span.line, first.span.column) == (code, line, column)


def test_the_reader_stops_after_ten_errors(path: Path) -> None:
    _, report = read(HEADER + "0,nan,nan\n" * 1000, path)
    assert len(report) == 10


def test_every_missing_joint_is_reported(path: Path) -> None:
    _, report = read("time,w0_axle.position\n0,0\n", path, ROBOT)
    assert [d.message.split("`")[1] for d in report] == [
        "w1_axle",
        "w2_axle",
        "w0_steering_axis",
        "w1_steering_axis",
    ]


def test_gaps_are_reported_and_the_rest_is_read(path: Path) -> None:
    log, report = read(HEADER + "0,0,1\n0.1,0,1\n0.7,0,1\n0.8,0,1\n3,0,1\n", path)
    assert log is not None
    assert len(log.times) == 5
    (gap,) = report
    assert gap.code.name == "joint-log-gap"
    assert "2 gaps" in gap.message
    assert "0.8 s to 3 s" in gap.message


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path, code in (
        (tmp_path / "none.csv", "file-not-found"),
        (tmp_path, "file-is-a-directory"),
    ):
        report = Report()
        assert read_log(path, path.name, DIFFERENTIAL, report) is None
        assert [d.code.name for d in report] == [code]


def test_written_numbers_keep_their_precision(path: Path) -> None:
    log, _ = read(record(ROBOT, seconds=1.0, twists=[(0, 0.3, 0.1, 0.7)]), path, ROBOT)
    assert log is not None
    speeds = [
        b - a for a, b in zip(log.positions["w0_axle"], log.positions["w0_axle"][1:], strict=False)
    ]
    assert max(abs(v) for v in speeds) > 1e-3
    assert all(math.isfinite(v) for v in speeds)
