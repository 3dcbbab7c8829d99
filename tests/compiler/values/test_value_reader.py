"""Numbers without a unit that are unusual on a robot."""

from __future__ import annotations

from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.values.value_reader import probable_unit

ROBOT = """\
thorvaldc: 1
name: r
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1100, width: 800}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 397 mm, 70 mm]}}
driver: {max_linear_velocity: 1, command_timeout: 500}
"""


@pytest.mark.parametrize(
    ("value", "quantity", "unit"),
    [
        (800.0, "length", "mm"),
        (-70.0, "length", "mm"),
        (12.0, "length", ""),
        (0.0, "length", ""),
        (1e9, "length", ""),
        (500.0, "time", "ms"),
        (12_000.0, "mass", "g"),
        (1500.0, "velocity", "mm/s"),
        (3000.0, "angular_velocity", "rpm"),
        (2.7, "density", "g/cm^3"),
        (2700.0, "density", ""),
        (1e6, "ratio", ""),
    ],
)
def test_unit_of_an_unusual_number(value: float, quantity: str, unit: str) -> None:
    assert probable_unit(value, quantity) == unit


def test_each_unusual_number_is_reported_once_and_with_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT, encoding="utf-8")
    report = compile_file(path).report
    assert [d.code.name for d in report.sorted()] == ["number-without-unit"] * 3
    hints = [d.hint or "" for d in report.sorted()]
    assert [hint.split("`")[1] for hint in hints] == ["1100 mm", "800 mm", "500 ms"]


def test_a_robot_with_the_proposed_units_has_no_warning(tmp_path: Path) -> None:
    text = ROBOT.replace("1100", "1100 mm").replace("800", "800 mm").replace("500", "500 ms")
    path = tmp_path / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    assert not list(compile_file(path).report)
