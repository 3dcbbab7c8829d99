"""The command ``scenario``, and ``sim`` of a scenario."""

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


def test_a_robot_file_is_no_scenario(thorvaldc: Command) -> None:
    result = thorvaldc("scenario", "good.yaml")
    assert (result.status, result.out) == (2, "")
    assert "good.yaml is no scenario; `thorvaldc sim good.yaml` drives a robot" in result.err
