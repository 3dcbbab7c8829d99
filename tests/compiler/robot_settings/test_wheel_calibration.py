"""Measured wheel values of a calibration file replace those of the modules."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Cylinder, Robot
from thorvaldc.model.model_json import from_json, to_json

ROBOT = """\
thorvaldc: 1
name: calibrated
driver: {max_linear_velocity: 1.495 m/s}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
"""
MEASURED = {"fl_wheel": 0.201, "fr_wheel": 0.1985, "rl_wheel": 0.2004, "rr_wheel": 0.2}


def build(folder: Path, robot: str = ROBOT) -> Robot:
    path = folder / "robot.yaml"
    path.write_text(robot, encoding="utf-8")
    compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    assert not len(compilation.report.errors)
    return compilation.model


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(Path(__file__).with_name("calibration.yaml"), tmp_path)
    return tmp_path


def calibrated(folder: Path) -> Robot:
    return build(folder, ROBOT + "calibration: calibration.yaml\n")


def test_model_has_the_measured_radii_and_offsets(folder: Path) -> None:
    robot = calibrated(folder)
    assert {w.name: w.radius for w in robot.wheels} == MEASURED
    offsets = {}
    for wheel in robot.wheels:
        motor = robot.actuator_of(wheel.steering_joint or "")
        assert motor is not None
        offsets[wheel.name] = motor.encoder_offset
        spin = robot.actuator_of(wheel.spin_joint)
        assert spin is not None
        assert spin.encoder_offset == 0.0
    assert offsets == {
        "fl_wheel": pytest.approx(math.radians(1.0)),
        "fr_wheel": -0.01,
        "rl_wheel": 0.0,
        "rr_wheel": 0.0,
    }


def test_robot_stands_level_on_all_its_wheels(folder: Path) -> None:
    plain, robot = build(folder), calibrated(folder)
    assert [w.contact_height for w in robot.wheels] == [0.0] * 4
    assert robot.joint("frame_mount") == plain.joint("frame_mount")
    assert [(w.x, w.y) for w in robot.wheels] == [(w.x, w.y) for w in plain.wheels]


def test_every_output_has_the_measured_radius(folder: Path) -> None:
    robot = calibrated(folder)
    shapes = {w.name: robot.link(w.link).collisions[0].shape for w in robot.wheels}
    assert all(len(robot.link(w.link).collisions) == 1 for w in robot.wheels)
    for name, shape in shapes.items():
        assert isinstance(shape, Cylinder)
        assert shape.radius == MEASURED[name]
    from thorvaldc.diagnostics import Report

    files = emit(robot, ["ros2"], Report())
    assert any(b"0.1985" in data for data in files.values())


def test_model_reads_back_equal(folder: Path) -> None:
    robot = calibrated(folder)
    assert from_json(to_json(robot)) == robot


def test_without_calibration_nothing_changes(folder: Path) -> None:
    empty = "thorvaldc: 1\nrobot: calibrated\nwheels: {}\n"
    (folder / "empty.yaml").write_text(empty, encoding="utf-8")
    plain = build(folder)
    included = build(folder, ROBOT + "calibration: empty.yaml\n")
    assert included.wheels == plain.wheels
    assert included.joints == plain.joints


def test_named_radii(folder: Path) -> None:
    text = """\
thorvaldc: 1
name: calibrated
calibration: greenhouse.yaml
modules:
  frame: {type: frame/tube_rectangular}
  fl:
    type: assembly/fixed_drive
    mount: frame.front_left
    params: {wheel: wheel/greenhouse_double}
  fr:
    type: assembly/fixed_drive
    mount: frame.front_right
    params: {wheel: wheel/greenhouse_double}
  rear: {type: caster/swivel, mount: frame.rear_center}
"""
    (folder / "greenhouse.yaml").write_text(
        "thorvaldc: 1\nrobot: calibrated\nwheels:\n"
        "  fl_wheel: {radius: 126 mm}\n  fr_wheel: {radii: {rail: 91 mm}}\n",
        encoding="utf-8",
    )
    wheels = {w.name: w for w in build(folder, text).wheels}
    left, right = wheels["fl_wheel"], wheels["fr_wheel"]
    assert left.radius == 0.126
    # The radius on the floor is that of the same tyre; the radius on rails is not.
    assert dict(left.radii) == {"floor": 0.126, "rail": 0.09}
    assert right.radius == 0.125
    assert dict(right.radii) == {"floor": 0.125, "rail": 0.091}
