"""The paper's odometry, a plug-in beside the bench: exact without noise, repeatable, its limits."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from bench.random_pairs.random_pairs_calculator import RandomPairs, RandomPairsOptions
from tests.conformance.wheels import wheel
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import CalculatorChoice
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry, for_robot
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SQUARE = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]
GEOMETRY = BaseGeometry.from_wheels(
    [wheel(f"w{i}", x, y, "steered") for i, (x, y) in enumerate(SQUARE)]
)


def joints(twist: Twist, error: float = 0.0) -> JointStates:
    commands = RandomPairs(GEOMETRY).command(twist).joints
    angles = [a + error * (-1) ** i for i, a in enumerate(commands.angles)]
    return JointStates(0.0, commands.speeds, angles, [0.0] * 4)


@pytest.mark.parametrize("special", [True, False])
@pytest.mark.parametrize(
    "twist",
    [
        Twist(0.5, 0.0, 0.4),
        Twist(0.3, -0.6, -0.5),
        Twist(0.0, 0.0, 1.0),
        Twist(0.4, 0.3, 0.0),
        ZERO_TWIST,
    ],
)
def test_exact_without_noise(twist: Twist, special: bool) -> None:
    calculator = RandomPairs(GEOMETRY, RandomPairsOptions(special_cases=special))
    assert calculator.odometry(joints(twist)).twist == pytest.approx(twist, abs=1e-9)


def test_pairs_repeat_with_their_seed() -> None:
    states = joints(Twist(0.5, 0.1, 0.4), 0.02)
    calculator, equal = RandomPairs(GEOMETRY), RandomPairs(GEOMETRY)
    other_seed = RandomPairs(GEOMETRY, RandomPairsOptions(seed=2))
    first = [calculator.odometry(states) for _ in range(3)]
    assert first == [equal.odometry(states) for _ in range(3)]
    assert first[0] != first[1]
    assert first[0] != other_seed.odometry(states)
    calculator.reset()
    assert calculator.odometry(states) == first[0]


def test_almost_parallel_lines_count_as_parallel() -> None:
    """Directions that differ by less than `parallel` have no useful intersection."""
    states = joints(Twist(0.5, 0.0, 0.002), 0.002)
    assert RandomPairs(GEOMETRY).odometry(states).twist.wz == 0.0
    plain = RandomPairs(GEOMETRY, RandomPairsOptions(special_cases=False))
    assert plain.odometry(states).twist.wz != 0.0


def test_one_wheel_has_no_pair() -> None:
    geometry = BaseGeometry.from_wheels(
        [wheel("w", 0.5, 0.0, "steered"), wheel("c", 0, 0, "swivel")]
    )
    assert "fewer than two wheels" in (RandomPairs.unsuited_reason(geometry) or "")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pairs_per_wheel": 0}, "1 to 1000"),
        ({"parallel": 0.0}, "between 0 and 1"),
        ({"hysteresis": -1.0}, "0 to 10"),
    ],
)
def test_options_out_of_range(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RandomPairsOptions(**options)  # type: ignore[arg-type]


def test_a_robot_file_names_the_installed_plugin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(__file__).resolve().parents[1] / "bench" / "random_pairs"
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "thorvaldc_random_pairs-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1\n")
    lines = [
        line
        for group, entries in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.syspath_prepend(str(tmp_path))
    choice = CalculatorChoice("random_pairs", (("seed", 3),))
    calculator = for_robot(replace(make_robot(FOUR_STEERED), calculator=choice))
    assert calculator.name == "random_pairs"
    assert calculator.options.seed == 3
