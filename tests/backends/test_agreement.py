"""URDF and MJCF agree, and the check that says so sees every seeded fault."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.backend_files import files_of
from tests.backends.agreement import differences
from tests.backends.conftest import write
from tests.backends.faults import FAULTS, Fault
from tests.backends.plans import ROBOTS, Plan, build, graft, grafted
from tests.examples import FLEETS, example_fleet, example_robot
from tests.examples import ROBOTS as EXAMPLES
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.backends.urdf import Urdf
from thorvaldc.model import Fleet, Robot

Written = Callable[[Robot], Path]
WrittenFleet = Callable[[Fleet], Path]


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_formats_agree(name: str, written: Written) -> None:
    assert differences(written(ROBOTS[name]), ROBOTS[name]) == []


@pytest.mark.parametrize("name", EXAMPLES)
def test_formats_agree_on_examples(name: str, written: Written) -> None:
    robot = example_robot(name)
    assert differences(written(robot), robot) == []


@pytest.mark.parametrize("name", FLEETS)
def test_formats_agree_in_fleets(name: str, written_fleet: WrittenFleet) -> None:
    fleet = example_fleet(name)
    folder = written_fleet(fleet)
    for placement in fleet.placements:
        assert differences(folder / placement.name, placement.robot) == []


@pytest.mark.parametrize("seed", range(18))
def test_formats_agree_on_random_trees(seed: int, written: Written) -> None:
    robot = grafted(seed)
    assert differences(written(robot), robot) == []


@pytest.fixture(scope="session")
def victim() -> Robot:
    """A robot with one of everything that the formats can say."""
    plans = [
        Plan(0.6, 0.5, suspended=True),
        Plan(0.6, -0.5, suspended=True),
        Plan(-0.6, 0.5, "fixed", radius=0.25),
        Plan(-0.6, -0.5, "swivel", radius=0.125, width=0.06, trail=-0.07),
    ]
    return graft(build(plans, name="victim"), seed=4, count=12)


@pytest.fixture(scope="session")
def sound(victim: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    return write({**files_of(Urdf, victim), **files_of(Mjcf, victim)}, folder)


def test_victim_is_sound(victim: Robot, sound: Path) -> None:
    assert differences(sound, victim) == []
    assert len(FAULTS) >= 40
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault_is_caught(fault: Fault, victim: Robot, sound: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mutant"
    shutil.copytree(sound, folder)
    path = folder / fault.file
    tree = ET.parse(path)
    before = ET.tostring(tree.getroot())
    fault.apply(tree.getroot())
    assert ET.tostring(tree.getroot()) != before, "the fault changed nothing"
    tree.write(path)
    assert differences(folder, victim) != []
