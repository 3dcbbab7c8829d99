"""The table of the odometry experiment agrees with its script."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "odometry_experiment"


@pytest.fixture(scope="module")
def experiment() -> ModuleType:
    spec = importlib.util.spec_from_file_location("odometry_experiment", FOLDER / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shown() -> dict[str, list[float]]:
    """Returns the rows of the README: true path, odometry, end error, end error of random pairs."""
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| ([^|]+?) \| ([\d.]+) m \| ([\d.]+) m \| ([\d.]+) m \| ([\d.]+) m", text, re.M
    )
    return {name: [float(value) for value in values] for name, *values in rows}


def test_the_table_has_every_case(experiment: ModuleType) -> None:
    names = [*experiment.CASES.values()]
    names += [f"{experiment.CASES[case]}, calibrated" for case in ("radii", "offsets")]
    assert sorted(shown()) == sorted(names)


def agrees(row: tuple[str, float, float, float, float]) -> None:
    name, *values = row
    true, odometry, end_error, pairs = shown()[name]
    assert values[:2] == pytest.approx([true, odometry], abs=0.05)
    # The last millimetres depend on the machine.
    assert values[2] == pytest.approx(end_error, rel=0.1, abs=0.01)
    # So do a few decimetres of the random pairs.
    assert values[3] == pytest.approx(pairs, abs=0.5)


def test_with_ideal_sensors_odometry_ends_within_50_mm_of_80_m(experiment: ModuleType) -> None:
    row, _, samples = experiment.drive(FOLDER / "ideal.yaml", experiment.CASES["ideal"])
    agrees(row)
    assert row.true == pytest.approx(80.0, abs=1.0)
    assert row.end_error <= 0.05
    assert samples[-1].time == pytest.approx(77.0)


def test_calibration_removes_the_offsets(experiment: ModuleType, tmp_path: Path) -> None:
    path, name = FOLDER / "offsets.yaml", experiment.CASES["offsets"]
    before, _, _ = experiment.drive(path, name)
    agrees(before)
    scenario = experiment.calibrated(path, tmp_path)
    after, _, _ = experiment.drive(scenario, f"{name}, calibrated")
    agrees(after)
    assert after.end_error < before.end_error / 20.0
