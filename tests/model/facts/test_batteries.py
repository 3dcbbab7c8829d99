"""Several batteries: one source in parallel, or none."""

from __future__ import annotations

from pathlib import Path

import pytest

import thorvaldc
from thorvaldc.model import Robot
from thorvaldc.model.facts.electrics import Energy, energy_of
from thorvaldc.model.facts.fact_tables import fact_tables
from thorvaldc.model.facts.robot_facts import robot_facts

BATTERY = """\
thorvaldc: 1
description: A battery of a given capacity, with electronics that state their power.
category: battery
params:
  capacity: {quantity: charge, default: 10 Ah, description: Capacity, source: "chosen: a test"}
mount: {kinds: [frame_clamp], link: box}
links: {box: {parts: [{shape: {box: [0.2, 0.2, 0.1]}, mass: 5 kg, source: "measured: a test"}]}}
battery: {present: true, link: box, properties: {capacity: "${capacity}", voltage: 48 V}}
can:
  protocol: small_battery
  ids: [0, 15]
  frames:
    charge: {cob_id: "${0x3E0 + id}", kind: broadcast, direction: report, length: 8, period: 1 s}
"""
SENSOR = """\
thorvaldc: 1
description: A sensor that draws 96 W.
mount: {kinds: [frame_clamp], link: box}
links: {box: {parts: [{shape: {box: [0.1, 0.1, 0.1]}, mass: 1 kg, source: "measured: a test"}]}}
sensor: {link: box, type: lidar_2d, properties: {power: 96 W}}
"""
ROBOT = """\
thorvaldc: 1
name: r
library: [parts]
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: caster/fixed, mount: frame.front_left}
  fr: {type: caster/fixed, mount: frame.front_right}
  rear: {type: caster/fixed, mount: frame.rear_center}
  lidar: {type: lidar, mount: {parent: frame, xyz: [0.1, 0, 0.1]}}
  a: {type: pack, mount: {parent: frame, xyz: [0, 0.2, 0.1]}}
"""
SECOND = (
    "  b: {type: pack, mount: {parent: frame, xyz: [0, -0.2, 0.1]}, params: {capacity: 30 Ah}}\n"
)


def robot_of(folder: Path, text: str) -> Robot:
    for name, document in (("pack", BATTERY), ("lidar", SENSOR)):
        path = folder / "parts" / name / "module.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(document, encoding="utf-8")
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    robot = thorvaldc.load(folder / "robot.yaml")
    assert isinstance(robot, Robot)
    return robot


def source(energy: Energy) -> tuple[float | None, ...]:
    return energy.voltage, energy.capacity, energy.standby, energy.standby_current


def test_one_battery_is_the_source(tmp_path: Path) -> None:
    energy = energy_of(robot_of(tmp_path, ROBOT))
    assert source(energy) == (48.0, 36_000.0, pytest.approx(5 * 3600.0), 2.0)


def test_batteries_in_parallel_are_one_source(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, ROBOT + SECOND + "batteries: parallel\n")
    energy = energy_of(robot)
    assert source(energy) == (48.0, 4 * 36_000.0, pytest.approx(20 * 3600.0), 2.0)
    (table,) = (t for t in fact_tables(robot_facts(robot)) if t.key == "energy")
    assert ("connection", "parallel, 48 V, 40 Ah") in table.rows
    assert ("standby", "20.0 h at 96 W and 2 A") in table.rows


@pytest.mark.parametrize(
    ("statement", "reason"),
    [
        ("batteries: separate\n", "which modules each battery supplies"),
        ("", "whether the batteries are in parallel"),
    ],
)
def test_other_batteries_are_no_common_source(tmp_path: Path, statement: str, reason: str) -> None:
    energy = energy_of(robot_of(tmp_path, ROBOT + SECOND + statement))
    assert source(energy) == (None, None, None, None)
    assert energy.energy == pytest.approx(4 * 48.0 * 36_000.0)  # they hold it all the same
    assert reason in energy.missing
