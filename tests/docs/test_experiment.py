"""The table of the odometry experiment agrees with its script."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.slow import mostly_slow

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


@pytest.mark.parametrize("case", mostly_slow(["ideal", "offsets", "radii", "rough"], 0, 2))
def test_the_script_prints_the_rows_of_the_table(experiment: ModuleType, case: str) -> None:
    rows, _, samples = experiment.experiment(case)
    for name, true, odometry, end_error, random_pairs in rows:
        expected = shown()[name]
        assert [true, odometry] == pytest.approx(expected[:2], abs=0.01)
        # The contacts of MuJoCo are not equal to the last bit on every machine.
        assert end_error == pytest.approx(expected[2], rel=0.02, abs=0.001)
        # Almost parallel axles enlarge these last bits, and the mean is that of ten runs.
        assert random_pairs == pytest.approx(expected[3], rel=0.2, abs=0.01)
    assert samples[-1].time == pytest.approx(77.0)
    if case == "ideal":
        assert rows[0].true == pytest.approx(80.0, abs=1.0)
    if len(rows) == 2:
        before, after = rows
        assert after.end_error < before.end_error / 20.0
