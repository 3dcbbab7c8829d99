"""Modules inside each other, in the way of a moving wheel, in the air and in the ground."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.examples import ROBOTS
from thorvaldc.compiler.pipeline import compile_file

ROOT = Path(__file__).parents[2]
FOUR = """thorvaldc: 1
name: four
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}}
"""
BOOM = """thorvaldc: 1
description: A boom that swings.
mount: {kinds: [frame_clamp], link: foot}
links:
  foot: {parts: [{shape: {box: [0.05, 0.05, 0.05]}, mass: 1 kg, source: "chosen: a test"}]}
  arm:
    parts:
      - {shape: {box: [1.5, 0.03, 0.03]}, xyz: [0.75, 0, 0], mass: 1 kg, source: "chosen: a test"}
joints:
  swing:
    {type: revolute, role: swivel, parent: foot, child: arm, axis: [0, 0, 1], lower: -1.5,
     upper: 1.5}
"""
POST = """thorvaldc: 1
description: A thin post.
mount: {kinds: [frame_clamp], link: post}
links:
  post: {parts: [{shape: {box: [0.03, 0.03, 0.5]}, mass: 1 kg, source: "chosen: a test"}]}
"""
CODES = (
    "parts-overlap",
    "part-loose",
    "part-below-ground",
    "wheels-overlap",
    "sensor-upside-down",
)


def room(folder: Path, text: str) -> list[tuple[str, int, str, str]]:
    """Returns code, line, message and hint of the diagnostics about the places of modules."""
    file = folder / "robot.yaml"
    file.write_text(text)
    report = compile_file(file).report
    return [
        (d.code.name, d.span.line if d.span is not None else 0, d.message, d.hint or "")
        for d in report
        if d.code.name in CODES
    ]


def test_a_robot_with_room_has_no_diagnostics(tmp_path: Path) -> None:
    assert room(tmp_path, FOUR) == []


@pytest.mark.parametrize("name", ROBOTS)
def test_the_examples_have_room(name: str) -> None:
    report = compile_file(ROOT / "examples" / name / "robot.yaml").report
    assert [d.message for d in report if d.code.name in CODES] == []
    assert not [d for d in report.accepted if d.diagnostic.code.name in CODES]


PLACED = {
    "in a front wheel": ("[0.55, 0.40, -0.45]", "parts-overlap", "160 mm inside `fl.wheel`"),
    "in the way of a steered wheel": (
        "[0, 0.45, -0.45]",
        "parts-overlap",
        "when `fl_steering_joint` is at",
    ),
    "over no tube": ("[0, 0.285, 0.07]", "part-loose", "touches nothing"),
    "1 m in the air": ("[0, 0.397, 1.07]", "part-loose", "touches nothing"),
    "in the ground": ("[0, 0, -0.7]", "part-below-ground", "160 mm below the ground"),
}


@pytest.mark.parametrize("place", PLACED)
def test_a_battery_in_a_wrong_place(place: str, tmp_path: Path) -> None:
    xyz, code, message = PLACED[place]
    diagnostics = room(tmp_path, FOUR.replace("[0, 0.397, 0.07]", xyz))
    assert (code, 9) in [(each[0], each[1]) for each in diagnostics]
    assert any(message in each[2] for each in diagnostics)
    assert len(diagnostics) <= 3  # a box between the wheels is also in the air


ADDED = {
    "a second battery in the first one": (
        "b2: {type: battery/enclosure, mount: {parent: frame, xyz: [0.01, 0.397, 0.07]}}",
        "parts-overlap",
        "`b2` is 230 mm inside `battery`",
        "down",
    ),
    "a lidar in the battery": (
        "laser: {type: sensor/lidar_2d, mount: {parent: frame, xyz: [0, 0.397, 0.15]}}",
        "parts-overlap",
        "inside `battery`",
        "up",
    ),
    "a lidar beside the robot": (
        "laser: {type: sensor/lidar_2d, mount: {parent: frame, xyz: [0, 3, 0]}}",
        "part-loose",
        "the nearest part is 2",
        "to the right",
    ),
    "a lidar upside down": (
        "laser: {type: sensor/lidar_2d, mount: {parent: frame, xyz: [0.426, 0, 0.04], "
        "rpy: [180 deg, 0, 0]}}",
        "sensor-upside-down",
        "the z axis of `laser_laser` points downwards",
        "turn its mount over",
    ),
    "a drive off its port": (
        "ml: {type: assembly/steered_drive, mount: {port: frame.mid_left, xyz: [0, 0.6, 0]}}",
        "part-loose",
        "`ml.steering` touches nothing",
        "to the right",
    ),
    "a drive 90 mm beside its tube": (
        "ml: {type: assembly/steered_drive, mount: {port: frame.mid_left, xyz: [0, 0.23, 0]}}",
        "part-loose",
        "`ml.steering` touches nothing",
        "move it",
    ),
}


@pytest.mark.parametrize("added", ADDED)
def test_a_module_in_a_wrong_place(added: str, tmp_path: Path) -> None:
    line, code, message, hint = ADDED[added]
    diagnostics = room(tmp_path, f"{FOUR}  {line}\n")
    assert [(each[0], each[1]) for each in diagnostics] == [(code, 10)]
    assert message in diagnostics[0][2]
    assert hint in diagnostics[0][3]


def test_two_legs_that_overlap_by_8_mm(tmp_path: Path) -> None:
    # The motors of the drives end 339 mm from the middle of their wheels.
    text = FOUR.replace("width: 0.9 m", "width: 0.67 m").replace("0.397", "0.282")
    diagnostics = room(tmp_path, text)
    assert sorted(each[2] for each in diagnostics) == [
        "`fr.drive` is 8 mm inside `fl.drive`",
        "`rr.drive` is 8 mm inside `rl.drive`",
    ]
    assert room(tmp_path, text.replace("0.67 m", "0.69 m").replace("0.282", "0.292")) == []


def test_the_correction_of_the_hint_is_enough(tmp_path: Path) -> None:
    laser = "  laser: {{type: sensor/lidar_2d, mount: {{parent: frame, xyz: [0, 0.397, {}]}}}}\n"
    ((*_, hint),) = room(tmp_path, FOUR + laser.format("0.2 m"))
    assert hint.startswith("move it at least 100 mm up")
    assert room(tmp_path, FOUR + laser.format("301 mm")) == []


def test_modules_in_one_place_are_not_reported_against_each_other_all(
    tmp_path: Path,
) -> None:
    sensors = "".join(
        f"  b{k}: {{type: sensor/imu, mount: {{parent: frame, xyz: [0, 0.45, {k * 1e-5:.5f}]}}}}\n"
        for k in range(300)
    )
    diagnostics = room(tmp_path, FOUR + sensors)
    assert 290 <= len(diagnostics) <= 900


def test_the_way_of_the_hint_leads_to_a_part(tmp_path: Path) -> None:
    laser = "  laser: {{type: sensor/lidar_2d, mount: {{parent: frame, xyz: [{}, {}, {}]}}}}\n"
    ((code, _, _, hint),) = room(tmp_path, FOUR + laser.format(0.3, 0.8, 0.5))
    assert code == "part-loose"
    ways = {
        "forwards": (0, 1),
        "backwards": (0, -1),
        "to the left": (1, 1),
        "to the right": (1, -1),
    }
    xyz = [0.3, 0.8, 0.5]
    for distance, words in re.findall(r"([\d.]+) mm ([a-z ]+?)(?: and|,)", hint):
        axis, sign = {**ways, "up": (2, 1), "down": (2, -1)}[words]
        xyz[axis] += sign * float(distance) / 1000
    assert room(tmp_path, FOUR + laser.format(*xyz)) == []


def test_a_thin_post_in_the_way_of_a_long_boom(tmp_path: Path) -> None:
    """The post is between two of the positions that are 10 deg apart."""
    boom, post = tmp_path / "modules/my/boom", tmp_path / "modules/my/post"
    for folder, text in ((boom, BOOM), (post, POST)):
        folder.mkdir(parents=True)
        (folder / "module.yaml").write_text(text)
    text = FOUR.replace("modules:\n", "library: [modules]\nmodules:\n")
    text += "  boom: {type: my/boom, mount: {parent: frame, xyz: [0.55, 0, 0.1]}}\n"
    text += "  post: {type: my/post, mount: {parent: frame, xyz: [1.8, 0.583, 0.1]}}\n"
    messages = [message for code, _, message, _ in room(tmp_path, text) if code == "parts-overlap"]
    assert any("when `boom_swing` is at 25 deg" in message for message in messages), messages


def test_the_warning_can_be_accepted(tmp_path: Path) -> None:
    laser = "  laser: {type: sensor/lidar_2d, mount: {parent: frame, xyz: [0, 0, 1 m]}}\n"
    accept = "accept: [{code: TV448, module: laser, reason: on a mast that is not described}]\n"
    assert len(room(tmp_path, FOUR + laser)) == 1
    assert room(tmp_path, FOUR + laser + accept.replace(", module: laser", "")) == []


# -- all modules on all ports ------------------------------------------------------------------

ASSEMBLIES = ("fixed_drive", "steered_drive", "suspended_steered_drive")
LENGTHS = {"frame/tube": {"length": "1 m"}, "frame/beam": {"length": "1 m"}}
EMPTY_PORTS = {("frame/tube_rectangular", "center")}  # without a cross member, nothing is there


def on_ports() -> Iterator[dict[str, Any]]:
    """Yields the modules of a robot for each module type on each port that it fits."""
    files = {
        p.parent.relative_to(ROOT / "modules").as_posix(): p
        for p in ROOT.glob("modules/*/*/*.yaml")
    }
    types = {name: yaml.safe_load(file.read_text()) for name, file in files.items()}
    kinds = {name: document.get("mount", {}).get("kinds", []) for name, document in types.items()}
    kinds |= {f"assembly/{name}": ["frame_clamp"] for name in ASSEMBLIES}
    for name, document in types.items():
        is_root = name.startswith("frame/") and name not in LENGTHS
        base: dict[str, Any] = {"type": name, "params": LENGTHS.get(name, {})}
        carriers = {"base": base}
        if not is_root:
            carriers = {
                "root": {"type": "frame/open"},
                "base": {**base, "mount": {"parent": "root"}},
            }
        for port, section in document.get("ports", {}).items():
            for mounted, fitting in kinds.items():
                if section["kind"] in fitting and (name, port) not in EMPTY_PORTS:
                    part = {"type": mounted, "mount": f"base.{port}"}
                    yield {**carriers, "part": part | {"params": LENGTHS.get(mounted, {})}}


@pytest.mark.slow
def test_each_module_has_room_on_each_port(tmp_path: Path) -> None:
    number = 0
    for modules in on_ports():
        text = yaml.safe_dump({"thorvaldc": 1, "name": "ports", "modules": modules})
        assert room(tmp_path, text) == [], modules
        number += 1
    assert number > 500
