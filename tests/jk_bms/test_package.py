"""The example package beside thorvaldc: commands with and without it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import needs_tools
from tests.example_packages import thorvaldc
from tests.examples import FOLDER, example_robot
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.model.facts.electrics import energy_of

ROBOT = str(FOLDER / "jk_bms" / "robot.yaml")


def test_check_and_build_import_no_code_of_the_package(jk_bms_package: list[str]) -> None:
    compilation = compile_file(Path(ROBOT))
    assert isinstance(compilation.model, Robot)
    assert not list(compilation.report)
    assert emit(compilation.model, ["urdf", "mjcf", "ros2", "can"])
    assert not [name for name in sys.modules if name.startswith("thorvaldc_jk_bms")]


def test_without_the_package_the_driver_is_unknown(tmp_path: Path) -> None:
    status, _, err = thorvaldc(tmp_path, [], "run", ROBOT, "--bus", "virtual", "--duration", "1s")
    assert status == 1
    assert "TV876" in err
    assert "there is no driver for the protocol `jk_bms` of `battery_left`" in err
    assert "(thorvaldc.batteries)" in err


def test_run_on_a_virtual_bus(tmp_path: Path, jk_bms_package: list[str]) -> None:
    arguments = ("--bus", "virtual", "--fast", "--twist", "0.5,0,0", "--duration", "3s", "--json")
    status, out, err = thorvaldc(tmp_path, jk_bms_package, "run", ROBOT, *arguments)
    assert (status, err) == (0, "")
    summary = json.loads(out)
    assert 1.2 < summary["pose"]["x"] < 1.6
    assert summary["supply"]["current"] == pytest.approx(6.0)


def test_the_facts_add_the_batteries_up() -> None:
    energy = energy_of(example_robot("jk_bms"))
    assert (energy.voltage, energy.capacity) == (51.2, 200 * 3600.0)
    assert energy.energy == pytest.approx(51.2 * 200 * 3600.0)


@needs_tools
@pytest.mark.slow
def test_the_faults_of_the_batteries(tmp_path: Path, jk_bms_package: list[str]) -> None:
    only = ("--only", "batter", "--json")
    status, out, err = thorvaldc(tmp_path, jk_bms_package, "faults", ROBOT, *only)
    assert status == 0, err
    faults = {row["fault"]: row for row in json.loads(out)["faults"]}
    assert "disarmed" in json.dumps(faults["all batteries empty"])
    assert "disarmed" not in json.dumps(faults["one of several batteries empty"])
    assert "disarmed" in json.dumps(faults["battery sends nothing"])
