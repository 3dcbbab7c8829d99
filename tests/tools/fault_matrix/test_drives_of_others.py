"""Faults of a motor controller of another package."""

from __future__ import annotations

from pathlib import Path

from tests.simulation.bus.test_plugins import acme, robot_with_acme_servo
from thorvaldc.tools.fault_matrix.fault_cases import DRIVING, STOPPING, Evidence
from thorvaldc.tools.fault_matrix.fault_matrix import FaultMatrix, FaultRow, row_cells, row_json

__all__ = ["acme"]  # a fixture


def test_the_matrix_includes_drives_of_other_packages(acme: Path) -> None:
    matrix = FaultMatrix(robot_with_acme_servo(acme))
    cases = {case.name: case for case in matrix.cases}
    assert {case.drives for case in matrix.cases} == {"acme_servo"}
    assert "encoder of a steering freezes" not in cases, "it has no steering"
    cut = matrix.react(cases["power of a drive cut"], DRIVING, Evidence())
    assert cut.reaction == "fault"
    assert cut.rest_time is not None
    frozen = matrix.react(cases["encoder of a wheel freezes"], STOPPING, Evidence())
    killed = matrix.react(cases["driver process killed"], DRIVING, Evidence())
    assert killed.rest_time is not None, "its watchdog of 0.2 s stops the wheels"
    row = FaultRow(cases["driver process killed"], {DRIVING: killed}, {})
    assert row_cells(matrix.robot, row)[-2] == "unlimited", "the model knows no watchdog"
    assert row_json(matrix.robot, row)["phases"][DRIVING]["promised"] == {}
    assert frozen.reaction in ("continues", "fault"), "it has no encoder that can freeze"
