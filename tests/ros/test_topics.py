"""The base `topics`: the base driver moves joints in another program, with the real rclpy."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.ros.environments import each_distro
from tests.ros.test_node import run_client
from tests.slow import mostly_exhaustive
from thorvaldc.compiler.pipeline import emit
from thorvaldc.ros.parameters import DIALECTS

pytestmark = each_distro()
STEERED = "4wd4ws_wide"
DRIVEN = "2wd0ws_greenhouse"


def build(name: str, folder: Path) -> Path:
    """Writes the model and the MJCF files of an example, and returns the path of the model."""
    for path, data in emit(example_robot(name), ["mjcf"]).items():
        (folder / name / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / name / path).write_bytes(data)
    return folder / name / "model.json"


def each_dialect() -> pytest.MarkDecorator:
    """The first dialect is in the quick group."""
    first, *others = DIALECTS
    marked = [pytest.param(dialect, marks=pytest.mark.slow) for dialect in others]
    return pytest.mark.parametrize("dialect", [first, *marked])


@pytest.mark.slow
@pytest.mark.parametrize("dialect", mostly_exhaustive(DIALECTS))
def test_wrong_joint_states_are_faults_with_their_reasons(
    distro: str, dialect: str, tmp_path: Path
) -> None:
    run_client(distro, "topic_faults", tmp_path, build(STEERED, tmp_path), dialect)


@pytest.mark.slow
@each_dialect()
def test_a_guard_stops_the_drives_of_a_silent_driver(
    distro: str, dialect: str, tmp_path: Path
) -> None:
    run_client(distro, "topic_guard", tmp_path, build(STEERED, tmp_path), dialect)


@each_dialect()
def test_commands_are_those_of_the_base_mujoco(distro: str, dialect: str, tmp_path: Path) -> None:
    models = [build(name, tmp_path) for name in (STEERED, DRIVEN)]
    differences = json.loads(run_client(distro, "topic_commands", tmp_path, dialect, *models))
    assert max(differences.values()) < 1e-9


@pytest.mark.slow
def test_commands_of_every_example_are_those_of_the_base_mujoco(
    distro: str, tmp_path: Path
) -> None:
    models = [build(name, tmp_path) for name in SAMPLED_ROBOTS]
    differences = json.loads(run_client(distro, "topic_commands", tmp_path, "gazebo", *models))
    assert len(differences) == len(SAMPLED_ROBOTS)
    assert max(differences.values()) < 1e-9
