"""The robot that `why` compiles many times is the robot of the compiler."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.examples import FOLDER, SAMPLED_ROBOTS, example_robot
from thorvaldc.comparison.robot_difference import leaf_differences, model_document
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.tools.provenance.influence_search import RobotProbe, scaled
from thorvaldc.tools.provenance.value_paths import all_paths, observed_value, value_at, with_values


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_without_changes_it_is_the_robot_of_the_compiler(name: str) -> None:
    with ExitStack() as stack:
        probe = RobotProbe(FOLDER / name / "robot.yaml", [], False, stack)
        robot, errors = probe.compile({})
    assert not errors
    assert robot == example_robot(name)


def test_a_change_of_a_document_is_that_of_its_file(tmp_path: Path) -> None:
    text = (FOLDER / "4wd4ws_slim/robot.yaml").read_text(encoding="utf-8")
    with ExitStack() as stack:
        probe = RobotProbe(FOLDER / "4wd4ws_slim/robot.yaml", [], False, stack)
        values = {value.key_path: value for value in probe.values()}
        width = values["modules.frame.params.width"]
        changed, _ = probe.compile({width: "700 mm"})
    path = tmp_path / "robot.yaml"
    path.write_text(text.replace(str(width.node.value), "700 mm"), encoding="utf-8")
    assert changed == compile_file(path).model


@pytest.mark.parametrize(
    ("value", "result"),
    [
        ("2 m", "3.0 m"),
        ("42:1", "63.0:1"),
        (4, 6.0),
        (0, 0.5),
        ("0 deg", "0.5 deg"),
        ("-2", "-3.0"),
    ],
)
def test_scaled_values_keep_their_units(value: object, result: object) -> None:
    assert scaled(value, 0.5) == result


def test_a_value_is_read_from_the_model_as_from_its_document() -> None:
    for name in ("4wd4ws_wide", "car", "odrive"):
        robot = example_robot(name)
        document = model_document(robot)
        for path in all_paths(document):
            if path[-1] != "kind":  # the class of a shape
                assert observed_value(robot, path) == value_at(document, path), path


def test_a_value_of_the_model_can_be_replaced_at_every_path() -> None:
    robot = example_robot("4wd4ws_slim")
    document = model_document(robot)
    paths = [path for path in all_paths(document) if path[-1] in ("radius", "mass", "id", "range")]
    assert len(paths) > 20
    for path in paths[::5]:
        changed = with_values(robot, {path: 3})
        assert isinstance(changed, Robot)
        leaves = list(leaf_differences(document, model_document(changed)))
        assert [leaf.path for leaf in leaves] == [path]
