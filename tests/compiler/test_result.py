"""Warnings that a document accepts, with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import thorvaldc
from tests.cli.conftest import GOOD, SHAKY
from thorvaldc.compiler.catalogue import check_library
from thorvaldc.diagnostics import CODES
from thorvaldc.diagnostics.renderers import render, render_accepted

ACCEPT = "accept:\n  - {code: TV408, at: design, reason: the mast is removed}\nmodules:\n"
ACCEPTED = SHAKY.replace("modules:\n", ACCEPT)


def compiled(folder: Path, text: str) -> thorvaldc.Compilation:
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return thorvaldc.compile(folder / "robot.yaml")


def names(report: thorvaldc.Report) -> list[str]:
    return [diagnostic.code.name for diagnostic in report]


def test_an_accepted_warning_is_no_warning(tmp_path: Path) -> None:
    assert names(compiled(tmp_path, SHAKY).report) == ["tip-over"]
    compilation = compiled(tmp_path, ACCEPTED)
    assert names(compilation.report) == []
    (accepted,) = compilation.report.accepted
    assert accepted.diagnostic.code.number == "TV408"
    assert accepted.reason == "the mast is removed"
    assert accepted.span[:3] == (str(tmp_path / "robot.yaml"), 5, 5)


@pytest.mark.parametrize(
    ("at", "is_accepted"),
    [
        ("", True),
        ("design", True),
        ("design.minimum_tip_over_angle", True),
        ("fl", False),
        ("modules.frame", False),
        ("modules", False),
    ],
)
def test_an_entry_holds_at_its_place(tmp_path: Path, at: str, is_accepted: bool) -> None:
    entry = f"at: {at}, " if at else ""
    report = compiled(tmp_path, ACCEPTED.replace("at: design, ", entry)).report
    assert sorted(names(report)) == ([] if is_accepted else ["accept-unused", "tip-over"])


def test_the_reason_is_required_and_keys_are_checked(tmp_path: Path) -> None:
    report = compiled(tmp_path, ACCEPTED.replace(", reason: the mast is removed", "")).report
    assert "missing-key" in names(report)
    report = compiled(
        tmp_path, ACCEPTED.replace("reason: the mast is removed", "reason: ''")
    ).report
    assert report.has_errors
    report = compiled(tmp_path, ACCEPTED.replace("reason:", "raeson:")).report
    assert "unknown-key" in names(report)


def test_an_error_is_never_accepted(tmp_path: Path) -> None:
    text = ACCEPTED.replace("can: 2", "can: 1").replace("TV408, at: design", "can-id-duplicate")
    assert {"accept-code", "can-id-duplicate"} <= set(names(compiled(tmp_path, text).report))
    unused = ACCEPTED.replace("TV408, at: design", "TV987")
    assert "accept-code" in names(compiled(tmp_path, unused).report)


def test_a_note_is_accepted_like_a_warning(tmp_path: Path) -> None:
    text = (
        "thorvaldc: 1\nname: r\nmodules:\n  frame: {type: frame/tube_rectangular}\n"
        "  l: {type: assembly/fixed_drive, mount: frame.front_left}\n"
        "  r: {type: assembly/fixed_drive, mount: frame.front_right}\n"
        "  rear: {type: caster/swivel, mount: frame.rear_center}\n"
    )
    assert names(compiled(tmp_path, text).report) == ["robot-without-controller"]
    accept = "accept: [{code: TV545, reason: the motors have cables only}]\n"
    report = compiled(tmp_path, text + accept).report
    assert names(report) == []
    assert [entry.diagnostic.code.number for entry in report.accepted] == ["TV545"]
    (unused,) = compiled(tmp_path, GOOD + accept).report
    assert unused.message == "there is no note TV545 robot-without-controller here any more"


def test_beside_errors_no_entry_is_called_unused(tmp_path: Path) -> None:
    text = ACCEPTED.replace("can: 2", "cam: 2")
    assert "accept-unused" not in names(compiled(tmp_path, text).report)


def test_warnings_of_later_commands_are_accepted_and_never_unused(tmp_path: Path) -> None:
    later = [c for c in CODES.values() if c.severity == "warning" and c.number[2] == "6"]
    entry = f"accept: [{{code: {later[0].number}, reason: a test}}]\nmodules:\n"
    compilation = compiled(tmp_path, GOOD.replace("modules:\n", entry))
    assert names(compilation.report) == []
    emitted = thorvaldc.Report()
    emitted.add(later[0].name, "a warning of a backend", compilation.model.span)
    assert names(compilation.located(emitted)) == []


def test_a_fleet_has_the_accepted_warnings_of_its_robots(tmp_path: Path) -> None:
    compiled(tmp_path, ACCEPTED)
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "thorvaldc: 1\nname: pair\nrobots:\n  a: {robot: robot.yaml}\n"
        "  b: {robot: robot.yaml, xyz: [3 m, 0, 0]}\n"
    )
    report = thorvaldc.compile(fleet).report
    assert names(report) == []
    assert len(report.accepted) == 1


MODULE = """\
thorvaldc: 1
description: A box on the frame.
accept: [{code: angle-in-radians, at: links, reason: the drawing has this number}]
mount: {kinds: [frame_clamp], link: body}
links:
  body:
    parts:
      - shape: {box: [0.1, 0.1, 0.1]}
        rpy: [0, 0, 90]
        mass: 2 kg
        source: "estimated: a test"
"""


def test_a_module_accepts_its_own_warnings(tmp_path: Path) -> None:
    folder = tmp_path / "modules/top/box"
    folder.mkdir(parents=True)
    module = folder / "module.yaml"
    robot = GOOD.replace("modules:\n", "library: [modules]\nmodules:\n") + (
        "  box: {type: top/box, mount: {parent: frame, xyz: [0, 0.397, 0.35]}}\n"
    )
    for text, in_check, in_robot in (
        (MODULE, [], []),
        (MODULE.replace("at: links", "at: mount"), ["angle-in-radians", "accept-unused"], None),
        (MODULE.replace("90]", "1]"), ["accept-unused"], []),
    ):
        module.write_text(text)
        assert names(check_library(tmp_path / "modules").report) == in_check
        if in_robot is not None:
            assert names(compiled(tmp_path, robot).report) == in_robot


def test_a_robot_accepts_the_warning_of_a_module_that_it_mounts(tmp_path: Path) -> None:
    folder = tmp_path / "modules/top/box"
    folder.mkdir(parents=True)
    lines = MODULE.splitlines(keepends=True)
    (folder / "module.yaml").write_text("".join(lines[:2] + lines[3:]))
    robot = GOOD.replace("modules:\n", "library: [modules]\nmodules:\n") + (
        "  box: {type: top/box, mount: {parent: frame, xyz: [0, 0.397, 0.35]}}\n"
    )
    assert names(compiled(tmp_path, robot).report) == ["angle-in-radians"]
    robot += "accept: [{code: angle-in-radians, at: box, reason: the drawing has it}]\n"
    assert names(compiled(tmp_path, robot).report) == []
    report = compiled(tmp_path, robot.replace("at: box", "at: fl")).report
    assert names(report) == ["angle-in-radians", "accept-unused"]


def test_all_formats_show_the_reason(tmp_path: Path) -> None:
    report = compiled(tmp_path, ACCEPTED).report
    assert "= reason: the mast is removed (" in render_accepted(report)
    document = json.loads(render(report, "json"))
    assert document["warnings"] == 0
    assert document["diagnostics"] == []
    assert document["accepted"][0]["code"] == "TV408"
    assert document["accepted"][0]["reason"] == "the mast is removed"
    (result,) = json.loads(render(report, "sarif"))["runs"][0]["results"]
    (suppression,) = result["suppressions"]
    assert suppression["kind"] == "inSource"
    assert suppression["justification"] == "the mast is removed"
    assert render(report, "github") == ""
