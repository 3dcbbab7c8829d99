"""``scenario``, ``batch`` and ``replay`` do what the options of ``sim`` do."""

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


def test_a_scenario_runs_by_either_spelling(thorvaldc: Command) -> None:
    result = json.loads(thorvaldc("scenario", "s.yaml", "--json").out)
    old_result = json.loads(thorvaldc("sim", "s.yaml", "--json").out)
    assert result["hash"] == old_result["hash"]
    other_robot = str(ROBOT.parents[1] / "6wd6ws/robot.yaml")
    assert "6: 6/6" in thorvaldc("scenario", "s.yaml", "--robot", other_robot).out
    assert "6: 6/6" in thorvaldc("sim", other_robot, "--scenario", "s.yaml").out


def test_a_value_of_a_scenario_is_replaced(thorvaldc: Command) -> None:
    setting = ("--set", "world.friction=0.2", "--json")
    result = json.loads(thorvaldc("scenario", "s.yaml", *setting).out)
    assert result["hash"] == json.loads(thorvaldc("sim", "s.yaml", *setting).out)["hash"]
    assert result["hash"] != json.loads(thorvaldc("scenario", "s.yaml", "--json").out)["hash"]
    several = thorvaldc("scenario", "s.yaml", "--set", "world.friction=0.2,0.3")
    assert several.status == 2
    assert "these are 2 runs; `thorvaldc batch` runs them" in several.err


def test_a_batch_runs_the_variations_of_the_scenario(thorvaldc: Command) -> None:
    result = thorvaldc("batch", "s.yaml", "-j", "1")
    assert result.status == 0, result.err
    assert "2 runs, all as expected" in result.out
    assert thorvaldc("sim", "s.yaml", "--variations", "-j", "1") == result
    settings = ("--set", "duration=200 ms,300 ms", "-j", "1")
    result = thorvaldc("batch", "s.yaml", *settings)
    assert "2 runs, all as expected" in result.out
    assert thorvaldc("sim", "s.yaml", *settings) == result
    both = thorvaldc("batch", "s.yaml", *settings, "--variations")
    assert "4 runs, all as expected" in both.out


def test_a_record_is_replayed_and_converted(thorvaldc: Command) -> None:
    assert thorvaldc("scenario", "s.yaml", "--record", "a.csv").status == 0
    result = thorvaldc("replay", "s.yaml", "a.csv", "--record", "b.csv")
    assert result.status == 0, result.err
    assert thorvaldc("sim", "s.yaml", "--replay", "a.csv").out == result.out
    assert Path("b.csv").read_bytes() == Path("a.csv").read_bytes()


@pytest.mark.parametrize("command", ["scenario", "batch"])
def test_a_robot_file_is_no_scenario(thorvaldc: Command, command: str) -> None:
    result = thorvaldc(command, "good.yaml")
    assert (result.status, result.out) == (2, "")
    assert "good.yaml is no scenario" in result.err


def test_the_help_of_sim_shows_the_options_of_a_drive(thorvaldc: Command) -> None:
    output = thorvaldc("sim", "--help").out
    assert "--twist" in output
    for option in ("--scenario", "--set", "--variations", "--replay", "--jobs", "--junit"):
        assert option not in output
