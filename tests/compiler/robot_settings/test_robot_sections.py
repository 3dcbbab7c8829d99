"""Tests of the section `ros` of a robot document, and of the packages of a fleet."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot, RosSettings
from thorvaldc.model.settings import package_name

BODY = """\
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
"""


def settings(folder: Path, text: str) -> RosSettings:
    path = folder / "robot.yaml"
    path.write_text(f"thorvaldc: 1\n{text}\n{BODY}", encoding="utf-8")
    compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), compilation.report
    return compilation.model.ros


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: cart", RosSettings("jazzy", "driver", "cart")),
        ("name: a__b_", RosSettings("jazzy", "driver", "a_b")),
        ("name: x", RosSettings("jazzy", "driver", "x_robot")),
        ("name: launch", RosSettings("jazzy", "driver", "launch_robot")),
        (
            "name: cart\nros: {distro: kilted, odom_tf: ekf, package: mine}",
            RosSettings("kilted", "ekf", "mine"),
        ),
        (
            "name: cart\nros: {license: MIT, maintainer: Bo & Co <b@c.d>, version: 1.20.0}",
            RosSettings("jazzy", "driver", "cart", "MIT", "Bo & Co <b@c.d>", "1.20.0"),
        ),
    ],
)
def test_settings_and_their_defaults(tmp_path: Path, text: str, expected: RosSettings) -> None:
    assert settings(tmp_path, text) == expected


@pytest.mark.parametrize(
    "text",
    [
        *("maintainer: Bo", "maintainer: b@c.d", "maintainer: <b@c.d>", "maintainer: Bo <b>"),
        *('version: "1.2"', "version: 1.2.3.4", "version: 01.2.3", "version: v1.2.3"),
        r'license: "MIT\nBSD"',
    ],
)
def test_a_text_that_no_manifest_can_have_is_an_error(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(f"thorvaldc: 1\nname: cart\nros: {{{text}}}\n{BODY}", encoding="utf-8")
    (error,) = compile_file(path).report.errors
    assert (error.code.name, error.span.line) == ("unknown-value", 3)


def test_twists_are_stamped_from_kilted_on() -> None:
    assert [RosSettings(distro).stamped for distro in ("jazzy", "kilted", "lyrical")] == [
        False,
        True,
        True,
    ]


def test_each_robot_of_a_fleet_has_its_own_package(tmp_path: Path) -> None:
    settings(tmp_path, "name: cart")
    (tmp_path / "fleet.yaml").write_text(
        "thorvaldc: 1\nname: pickers\nrobots:\n"
        "  r: {robot: robot.yaml, grid: {columns: 2, spacing: 5 m}}\n",
        encoding="utf-8",
    )
    fleet = compile_file(tmp_path / "fleet.yaml").model
    assert isinstance(fleet, Fleet)
    assert [p.robot.ros.package for p in fleet.placements] == ["cart_r_1", "cart_r_2"]


@given(st.text())
def test_every_text_has_an_allowed_name_that_does_not_change(text: str) -> None:
    name = package_name(text)
    assert re.fullmatch("[a-z][a-z0-9]*(_[a-z0-9]+)*", name)
    assert len(name) >= 2
    assert package_name(name) == name


def test_a_topic_leaves_room_for_the_name_space(tmp_path: Path) -> None:
    def codes(length: int) -> list[str]:
        path = tmp_path / "robot.yaml"
        topic = "t" * length
        sources = f"driver: {{twist_sources: {{row: {{priority: 20, topic: {topic}}}}}}}"
        path.write_text(f"thorvaldc: 1\nname: cart\n{sources}\n{BODY}", encoding="utf-8")
        return [d.code.number for d in compile_file(path).report.errors]

    assert codes(180) == []
    assert len(codes(181)) == 1
