"""No generated file contains a placeholder or a statement of the templates of thorvaldc."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from thorvaldc import backends
from thorvaldc.backends.ros2 import package_of
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.scaffolding import presets, project_files, robot_files
from thorvaldc.model import Fleet, Robot

PLACEHOLDER = re.compile(r"@[A-Z][A-Z0-9_]*@|\{\{|\{%|# %")
OF_OTHERS = {"@BUS_CONFIG_PATH@"}  # ros2_canopen replaces it
MESHES = (".stl", ".obj", ".png")


def placeholders(files: Iterable[tuple[str, str | bytes]]) -> list[tuple[str, str]]:
    """Return the path of the file and the text of each placeholder."""
    found = []
    for path, content in files:
        text = content if isinstance(content, str) else content.decode(errors="replace")
        found += [(path, text) for text in PLACEHOLDER.findall(f"{path}\n{text}")]
    return [(path, text) for path, text in found if text not in OF_OTHERS]


def output(model: Robot | Fleet) -> list[tuple[str, bytes]]:
    files = emit(model, backends.names())
    return [(path, data) for path, data in files.items() if not path.endswith(MESHES)]


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_examples(name: str) -> None:
    robot = example_robot(name)
    assert placeholders(output(robot)) == []
    other = replace(robot, namespace="r1", ros=replace(robot.ros, odom_tf="ekf"))
    assert placeholders(package_of(other).items()) == []


@pytest.mark.parametrize("name", FLEETS)
def test_fleets(name: str) -> None:
    assert placeholders(output(example_fleet(name))) == []


@pytest.mark.parametrize("preset", presets())
def test_presets(preset: str, tmp_path: Path) -> None:
    assert placeholders(project_files("mine", preset, "0.1.0").items()) == []
    files = robot_files("mine", preset)
    assert placeholders(files.items()) == []
    (tmp_path / "robot.yaml").write_text(files["robot.yaml"])
    robot = compile_file(tmp_path / "robot.yaml").model
    assert isinstance(robot, Robot)
    assert placeholders(output(robot)) == []
