"""One run reports every error of a file once, at its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import compile_file

# The lines contain the errors in EXPECTED; misspellings are deliberate.
PLANTED = """\
thorvaldc: 1
name: planted
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 kg, width: 0.9 m}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: 3, parms: {}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 3}
  rl: {type: assembly/steered_drive, mount: frme.rear_left, can: on}
  rr: {type: assembly/steered_drive, mount: frame.rear_rihgt, can: 010, params: {gear_ratio: 0.1}}
  lidar: {type: sensor/lidar_2d, mount: fl.drive.hub}
  bat: {type: battery/enclosre, mount: {parent: fl, xyz: [0, 0, 0]}}
design: {slope: 1 m}
"""

EXPECTED = [
    (4, "wrong-dimension"),
    (5, "unknown-key"),
    (6, "can-id-duplicate"),
    (7, "module-unknown"),
    (7, "yaml-ambiguous-word"),
    (8, "param-range"),
    (8, "port-unknown"),
    (8, "yaml-leading-zero"),
    (9, "port-kind"),
    (10, "module-type-unknown"),
    (11, "wrong-dimension"),
]


def test_errors_of_all_stages_are_reported_in_one_run(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(PLANTED, encoding="utf-8")
    compilation = compile_file(file)
    assert compilation.model is None
    reported = [(d.span.line, d.code.name) for d in compilation.report.sorted() if d.span]
    assert sorted(reported) == EXPECTED
    assert all(d.span and d.span.file == str(file) for d in compilation.report)


def test_physics_is_checked_in_spite_of_bus_errors(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        """\
thorvaldc: 1
name: heavy
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: 1}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 1}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, can: 2}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, can: 3}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}}
design: {minimum_tip_over_angle: 80 deg}
""",
        encoding="utf-8",
    )
    names = [d.code.name for d in compile_file(file).report]
    assert names == ["can-id-duplicate", "tip-over"]


CART = """\
thorvaldc: 1
name: cart
{head}modules:
  frame: {{type: frame/tube_rectangular}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right}}
  rl: {{type: assembly/steered_drive, mount: frame.rear_left}}
  rr: {{type: assembly/steered_drive, {rr}}}
  battery: {{type: battery/enclosure, mount: {{parent: frame, xyz: [0, 0.397, 0.07]}}}}
"""


@pytest.mark.parametrize(
    ("rr", "head", "code"),
    [
        ("mount: frame.", "", "bad-id"),
        ("mount: [frame, rear_right]", "", "wrong-type"),
        ("mount: frame", "", "port-unknown"),
        ("mount: {port: frame.rear_right, rpy: [0, 0, 90 m]}", "", "wrong-dimension"),
        ("mount: frame.rear_right", "buses: {main: {bitrate: 333 kbit/s}}\n", "can-bitrate"),
        ("mount: frame.rear_right", "driver: {rate: 0}\n", "driver-cycle"),
        ("mount: frame.rear_right", "design: {slope: 10}\n", "number-out-of-range"),
    ],
)
def test_one_error_is_reported_once(rr: str, head: str, code: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(CART.format(rr=rr, head=head), encoding="utf-8")
    assert [d.code.name for d in compile_file(file).report] == [code]
