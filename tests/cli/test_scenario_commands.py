"""The commands ``scenario`` and ``batch``, and ``sim`` of a scenario."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Command

ROBOT = Path(__file__).resolve().parents[2] / "examples/4wd4ws_slim/robot.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: short
robots: {{cart: {{robot: {ROBOT}}}}}
duration: 400 ms
world: {{friction: 0.5}}
script: [{{at: 0, vx: 0.5 m/s}}]
variations: {{vary: {{world.friction: [0.2, 0.6]}}}}
"""


@pytest.fixture(autouse=True)
def scenario(thorvaldc: Command) -> None:
    Path("s.yaml").write_text(SCENARIO)


def test_sim_runs_a_scenario(thorvaldc: Command) -> None:
    result = json.loads(thorvaldc("scenario", "s.yaml", "--json").out)
    same_result = json.loads(thorvaldc("sim", "s.yaml", "--json").out)
    assert result["hash"] == same_result["hash"]
    other_robot = str(ROBOT.parents[1] / "6wd6ws/robot.yaml")
    assert "6: 6/6" in thorvaldc("scenario", "s.yaml", "--robot", other_robot).out


def test_a_value_of_a_scenario_is_replaced(thorvaldc: Command) -> None:
    setting = ("--set", "world.friction=0.2", "--json")
    result = json.loads(thorvaldc("scenario", "s.yaml", *setting).out)
    assert result["hash"] != json.loads(thorvaldc("scenario", "s.yaml", "--json").out)["hash"]
    several = thorvaldc("scenario", "s.yaml", "--set", "world.friction=0.2,0.3")
    assert several.status == 1
    assert "--set world.friction" in several.err


def test_a_batch_runs_the_variations_of_the_scenario(thorvaldc: Command) -> None:
    result = thorvaldc("batch", "s.yaml", "-j", "1")
    assert result.status == 0, result.err
    assert "2 runs, all as expected" in result.out
    settings = ("--set", "duration=200 ms,300 ms", "-j", "1")
    result = thorvaldc("batch", "s.yaml", *settings)
    assert "2 runs, all as expected" in result.out
    both = thorvaldc("batch", "s.yaml", *settings, "--variations")
    assert "4 runs, all as expected" in both.out


@pytest.mark.parametrize("command", ["scenario", "batch"])
def test_a_robot_file_is_no_scenario(thorvaldc: Command, command: str) -> None:
    result = thorvaldc(command, "good.yaml")
    assert (result.status, result.out) == (2, "")
    assert "good.yaml is no scenario" in result.err
