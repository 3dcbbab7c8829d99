"""A number without a unit, and what follows from it."""

from __future__ import annotations

from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Diagnostic, Severity

ROBOT = """\
thorvaldc: 1
name: r
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: 3}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 2}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, can: 4}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, can: 1}
"""


def diagnostics(folder: Path, text: str) -> list[Diagnostic]:
    path = folder / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return compile_file(path).report.sorted()


def test_a_length_without_a_unit_blames_no_innocent_wheel(tmp_path: Path) -> None:
    text = ROBOT.replace("can: 3}", "can: 3, params: {height: 650}}")
    found = diagnostics(tmp_path, text)
    assert sorted(d.code.name for d in found) == ["number-without-unit", "wheel-off-ground"]
    assert {d.span.line for d in found if d.span is not None} == {5}
    (error,) = (d for d in found if d.code.name == "wheel-off-ground")
    assert error.message.startswith("with this number, the wheel of")
    assert error.hint == "first give the number its unit"


def test_an_accepted_number_has_no_consequences(tmp_path: Path) -> None:
    text = ROBOT.replace("can: 3}", "can: 3, params: {height: 650}}")
    accept = "accept: [{code: TV219, reason: a mast of 650 m}]\n"
    found = [d for d in diagnostics(tmp_path, text + accept) if d.code.name == "wheel-off-ground"]
    assert {d.span.line for d in found if d.span is not None} == {6, 7, 8}


@pytest.mark.parametrize("accepted", [False, True])
def test_a_time_without_a_unit_moves_no_error(tmp_path: Path, accepted: bool) -> None:
    text = ROBOT.replace("rr: {", "# rr: {") + "driver: {command_timeout: 500}\n"
    text = text.replace("  rl: ", "  # rl: ")
    if accepted:
        text += "accept: [{code: TV219, reason: it waits for ever}]\n"
    (error,) = (d for d in diagnostics(tmp_path, text) if d.code.name == "unstable")
    assert error.message.startswith("the robot stands on a line")


def test_a_caster_upside_down_is_turned_not_lowered(tmp_path: Path) -> None:
    text = ROBOT + (
        "  c: {type: caster/fixed, mount: {port: frame.rear_center, rpy: [180 deg, 0, 0]}}\n"
    )
    (error,) = [d for d in diagnostics(tmp_path, text) if d.severity is Severity.ERROR]
    assert error.code.name == "wheel-off-ground"
    assert "1000 mm" in error.message
    assert error.hint == "turn its mount over (`rpy`): the module is upside down"


def test_a_part_that_does_not_fit_in_an_assembly_names_the_line_of_the_user(
    tmp_path: Path,
) -> None:
    wheel = tmp_path / "parts" / "my_wheel" / "module.yaml"
    wheel.parent.mkdir(parents=True)
    wheel.write_text(
        "thorvaldc: 1\ndescription: Wheel.\ncategory: wheel\n"
        "mount: {kinds: [odd_flange], link: tyre}\n"
        "links: {tyre: {parts: [{shape: {sphere: {radius: 0.2}}, mass: 4 kg,"
        ' source: "measured: x"}]}}\n'
        'wheel: {link: tyre, radius: 0.2, width: 0.1, friction: 0.8, source: "measured: x"}\n',
        encoding="utf-8",
    )
    text = ROBOT.replace("can: 2}", "can: 2, params: {wheel: my_wheel}}") + "library: [parts]\n"
    (error,) = diagnostics(tmp_path, text)
    assert error.code.name == "port-kind"
    assert error.span is not None
    assert (error.span.file, error.span.line) == (str(tmp_path / "robot.yaml"), 6)
