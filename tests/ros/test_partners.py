"""How programs of others begin to talk to the node, and what the robot does then.

tests/ros/partners/ is a catalogue of scripts, written from the sources of these programs.  Each
expectation is that of a person who uses such a program: the robot moves within a time, stands, or
refuses and names the reason.  ``decided``: a rule of safety wins, and the node names this reason.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.backends.ros2.packages import package_of, variant, write
from tests.ros.environments import DISTROS, each_distro
from tests.ros.test_node import run_client
from thorvaldc.model import TwistInput
from thorvaldc.model.settings import NAME_PREFIX

SCRIPTS = Path(__file__).parent / "partners"
ANY_FIRST = TwistInput("direct", "direct/cmd_vel", 60, 0.5, "any")
GATE = TwistInput("gate", "gate/lock", 200, 0.5)


def partners() -> Iterator[Any]:
    """Yields each partner with each distribution.

    With the second one, CI plays the scripts of Nav2, which differ between the distributions.
    """
    for distro in DISTROS:
        for file in sorted(SCRIPTS.glob("*.yaml")):
            plays = distro == DISTROS[0] or file.stem == "nav2"
            group = pytest.mark.slow if plays else pytest.mark.exhaustive
            marks = [group, pytest.mark.xdist_group(f"ros-{distro}")]
            yield pytest.param(distro, file.stem, marks=marks)


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with packages for each distribution: `plain`, and `gate` with a lock more.

    A source of both packages begins with any twist.
    """
    folder = tmp_path_factory.mktemp("packages")
    for distro in DISTROS:
        robot = variant("4wd4ws_wide", distro=distro)
        robot = dataclasses.replace(robot, twist_sources=(*robot.twist_sources, ANY_FIRST))
        locked = dataclasses.replace(robot, twist_locks=(*robot.twist_locks, GATE))
        for name, each in (("plain", robot), ("gate", locked)):
            # The launch files put the names in.
            files = {p: d.replace(NAME_PREFIX.encode(), b"") for p, d in package_of(each).items()}
            write(folder / distro / name, files)
    return folder


def plays(distro: str, packages: Path, tmp_path: Path, partner: str, *scripts: str) -> None:
    """Plays scripts to nodes of one process, and compares what the robots did with what is
    expected."""
    arguments = (packages / distro, SCRIPTS / f"{partner}.yaml", distro, *scripts)
    answers = json.loads(run_client(distro, "partners_rig", tmp_path, *arguments))
    assert answers
    wrong = {
        script: of_sources
        for script, of_sources in answers.items()
        if any(map(any, of_sources.values()))
    }
    assert not wrong


@pytest.mark.slow
@each_distro()
def test_a_goal_of_nav2(distro: str, packages: Path, tmp_path: Path) -> None:
    plays(distro, packages, tmp_path, "nav2", "first_goal")


@each_distro()
def test_twists_of_another_type_are_named(distro: str, packages: Path, tmp_path: Path) -> None:
    plays(distro, packages, tmp_path, "teleop_twist_joy", "other_type")


@pytest.mark.parametrize(("distro", "partner"), list(partners()))
def test_a_partner_is_followed_or_refused_with_a_reason(
    distro: str, partner: str, packages: Path, tmp_path: Path
) -> None:
    scripts = yaml.safe_load((SCRIPTS / f"{partner}.yaml").read_text())["scripts"]
    plays(distro, packages, tmp_path, partner, *scripts)
