"""``thorvaldc info``, as its users call it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.examples import FLEETS, FOLDER, SAMPLED_ROBOTS


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_the_text_of_an_example_fits_80_columns(thorvaldc: Command, name: str) -> None:
    result = thorvaldc("info", str(FOLDER / name / "robot.yaml"), "--all")
    assert result.status == 0
    lines = result.out.splitlines()
    assert max(map(len, lines)) <= 80
    for title in ("Size", "Wheel loads", "Tip-over angles", "Steepest slopes", "Wiring"):
        assert title in lines


def test_groups_of_addresses_are_words(thorvaldc: Command) -> None:
    lines = thorvaldc("info", str(FOLDER / "4wd4ws_wide" / "robot.yaml")).out.splitlines()
    (battery,) = (
        line for line in lines if line.strip().startswith("battery_left ") and "0x" in line
    )
    assert battery.split() == [
        "battery_left",
        "1",
        "(0x01)",
        "kc",
        "battery",
        "thorvald_kc_battery",
    ]


def test_json_of_a_robot(thorvaldc: Command) -> None:
    result = thorvaldc("info", "good.yaml", "--json")
    assert result.status == 0
    facts = json.loads(result.out)
    assert facts["size"]["wheelbase"] == pytest.approx(1.1, abs=0.2)
    assert sum(wheel["share"] for wheel in facts["wheels"]) == pytest.approx(1.0)
    assert set(facts["stability"]["angles"]) == {"front", "left", "rear", "right"}


def test_a_fleet_has_the_facts_of_each_robot(thorvaldc: Command) -> None:
    fleet = str(FOLDER / FLEETS[0] / "fleet.yaml")
    robots = json.loads(thorvaldc("info", fleet, "--json").out)["robots"]
    assert list(robots) == ["tall", "slim", "wide", "six"]
    text = thorvaldc("info", fleet).out
    assert text.count("\nTip-over angles\n") == 4


def test_a_build_has_the_facts_of_its_robot_file(thorvaldc: Command) -> None:
    assert thorvaldc("build", "good.yaml", "-o", "out").status == 0
    assert thorvaldc("info", "out").out == thorvaldc("info", "good.yaml").out


def test_a_model_file_without_meshes_says_so(thorvaldc: Command) -> None:
    assert thorvaldc("build", "good.yaml", "-o", "out").status == 0
    Path("alone").mkdir()
    Path("alone/model.json").write_bytes(Path("out/model.json").read_bytes())
    result = thorvaldc("info", "alone")
    assert result.status == 0
    assert "not part of this model file" in result.out


def test_a_robot_with_errors_has_no_facts(thorvaldc: Command) -> None:
    Path("bad.yaml").write_text("thorvaldc: 1\nname: bad\nmodules: {}\n", encoding="utf-8")
    result = thorvaldc("info", "bad.yaml")
    assert result.status == 1
    assert result.out == ""
    assert "error" in result.err
