"""CSV records: each value in its own column."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.records.csv_record import CsvRecorder

ROBOT = make_robot(FOUR_STEERED)
COMMANDS = JointCommands([1.5, 2.5, 3.5, 4.5], [0.15, 0.25, 0.35, 0.45])
GROUPS = ("odometry", "truth", "twist", "joints")


def sample(time: float) -> Sample:
    return Sample(
        time,
        Twist(1.0, 2.0, 3.0),
        Twist(4.0, 5.0, 6.0),
        Twist(7.0, 8.0, 9.0),
        Twist(10.0, 11.0, 12.0),
        Pose2(13.0, 14.0, 15.0),
        Pose2(16.0, 17.0, 18.0),
        JointStates(time, [1.0, 2.0, 3.0, 4.0], [0.1, 0.2, 0.3, 0.4], [0.0] * 4, [5.0, 6, 7, 8]),
        (19.0, 20.0, 21.0),
    )


def write(path: Path, groups: tuple[str, ...] = GROUPS, every: float = 0.0) -> None:
    recorder = CsvRecorder(path, [("one", ROBOT)], groups, every)
    for tick in range(5):
        recorder.record("one", sample(0.25 * tick), COMMANDS)
    recorder.close()


def test_columns_of_all_groups(tmp_path: Path) -> None:
    write(tmp_path)
    header, line = (tmp_path / "one.csv").read_text().splitlines()[:2]
    cells = dict(zip(header.split(","), map(float, line.split(",")), strict=True))
    parts = {"pose": ("x", "y", "yaw"), "twist": ("vx", "vy", "wz")}
    expected = {"time": 0.0}
    for name, kind, first in (
        ("odometry", "pose", 13),
        ("odometry", "twist", 7),
        ("true", "pose", 16),
        ("true", "twist", 10),
        ("asked", "twist", 1),
        ("aimed", "twist", 4),
    ):
        expected |= {f"{name}_{part}": first + k for k, part in enumerate(parts[kind])}
    expected |= {"true_z": 19.0, "true_roll": 20.0, "true_pitch": 21.0}
    for k, wheel in enumerate(ROBOT.wheels):
        spin, steering = wheel.spin_joint, wheel.steering_joint
        expected[f"{spin}.position"], expected[f"{spin}.velocity"] = 5.0 + k, 1.0 + k
        expected[f"{spin}.velocity_command"] = 1.5 + k
        expected[f"{steering}.position"] = pytest.approx(0.1 + 0.1 * k)
        expected[f"{steering}.position_command"] = pytest.approx(0.15 + 0.1 * k)
    assert cells == expected


@pytest.mark.parametrize(
    ("group", "prefixes"),
    [("odometry", {"odometry"}), ("truth", {"true"}), ("twist", {"asked", "aimed"})],
)
def test_a_record_has_the_columns_of_its_groups(
    tmp_path: Path, group: str, prefixes: set[str]
) -> None:
    write(tmp_path, (group,))
    header, line = (tmp_path / "one.csv").read_text().splitlines()[:2]
    time, *columns = header.split(",")
    assert time == "time"
    assert {column.partition("_")[0] for column in columns} == prefixes
    assert line.count(",") == len(columns)


def test_samples_at_an_interval(tmp_path: Path) -> None:
    write(tmp_path / "one.csv", ("twist",), 0.5)
    lines = (tmp_path / "one.csv").read_text().splitlines()[1:]
    assert [float(line.partition(",")[0]) for line in lines] == [0.0, 0.5, 1.0]


def test_numbers_have_nine_digits_and_no_negative_zero(tmp_path: Path) -> None:
    recorder = CsvRecorder(tmp_path, [("one", ROBOT)], ("twist",))
    numbers = Twist(1 / 3, -0.0, math.nan)
    recorder.record("one", replace(sample(0.0), commanded=numbers), COMMANDS)
    recorder.close()
    cells = (tmp_path / "one.csv").read_text().splitlines()[1].split(",")
    assert cells[:4] == ["0", "0.333333333", "0", ""]
