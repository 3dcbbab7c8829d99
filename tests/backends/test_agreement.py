"""URDF and MJCF agree, and the check detects every seeded error."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.backend_files import files_of
from tests.backends.agreement import differences
from tests.backends.conftest import write
from tests.backends.plans import ROBOTS, SAMPLED_PLANS, Plan, build, graft, grafted
from tests.backends.seeded_errors import SEEDED_ERRORS, SeededError
from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.slow import mostly_exhaustive
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.backends.urdf import Urdf
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.statics.standing_pose import solve_statics

Written = Callable[[Robot], Path]
WrittenFleet = Callable[[Fleet], Path]


@pytest.mark.parametrize("name", SAMPLED_PLANS)
def test_formats_agree(name: str, written: Written) -> None:
    assert differences(written(ROBOTS[name]), ROBOTS[name]) == []


def test_formats_agree_on_swing_arms_that_turn_far(written: Written) -> None:
    """The robot stands at rest in MuJoCo with its arms turned by 3 to 9 degrees."""
    plans = [
        Plan(0.6, 0.5, suspended=True, arm=0.25, sag=0.06),
        Plan(0.55, -0.45, suspended=True, arm=-0.3, sag=-0.08),
        Plan(-0.5, 0.4, suspended=True, arm=0.2, sag=0.05),
        Plan(-0.6, -0.5, "fixed", suspended=True, arm=0.35, sag=0.16, radius=0.25),
    ]
    robot = build(plans, body_com=(0.1, -0.05, 0.0))
    statics = solve_statics(robot)
    assert statics.settled
    assert max(map(abs, statics.positions.values())) > 0.1
    assert differences(written(robot), robot) == []


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_formats_agree_on_examples(name: str, written: Written) -> None:
    robot = example_robot(name)
    assert differences(written(robot), robot) == []


@pytest.mark.parametrize("name", FLEETS)
def test_formats_agree_in_fleets(name: str, written_fleet: WrittenFleet) -> None:
    fleet = example_fleet(name)
    folder = written_fleet(fleet)
    for placement in fleet.placements:
        assert differences(folder / placement.name, placement.robot) == []


@pytest.mark.parametrize("seed", mostly_exhaustive(range(18), 3))
def test_formats_agree_on_random_trees(seed: int, written: Written) -> None:
    robot = grafted(seed)
    assert differences(written(robot), robot) == []


@pytest.fixture(scope="session")
def victim() -> Robot:
    """A robot with one of everything that the formats can express."""
    plans = [
        Plan(0.6, 0.5, suspended=True),
        Plan(0.6, -0.5, suspended=True),
        Plan(-0.6, 0.5, "fixed", radius=0.25),
        Plan(-0.6, -0.5, "swivel", radius=0.125, width=0.06, trail=-0.07),
    ]
    return graft(build(plans, name="victim"), seed=4, count=12)


@pytest.fixture(scope="session")
def correct_files(victim: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    return write({**files_of(Urdf, victim), **files_of(Mjcf, victim)}, folder)


def test_unchanged_files_agree(victim: Robot, correct_files: Path) -> None:
    assert differences(correct_files, victim) == []
    assert len(SEEDED_ERRORS) >= 40
    assert len({error.name for error in SEEDED_ERRORS}) == len(SEEDED_ERRORS)


# A third of the errors, of all kinds, is quick: they test the comparison and not the formats.
THIRD = SEEDED_ERRORS[::3]
OTHERS = [error for error in SEEDED_ERRORS if error not in THIRD]


@pytest.mark.parametrize(
    "error", mostly_exhaustive([*THIRD, *OTHERS], len(THIRD)), ids=lambda error: error.name
)
def test_seeded_error_is_detected(
    error: SeededError, victim: Robot, correct_files: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "mutant"
    shutil.copytree(correct_files, folder)
    path = folder / error.file
    tree = ET.parse(path)
    original = ET.tostring(tree.getroot())
    error.apply(tree.getroot())
    assert ET.tostring(tree.getroot()) != original, "the change has no effect"
    tree.write(path)
    assert differences(folder, victim) != []
