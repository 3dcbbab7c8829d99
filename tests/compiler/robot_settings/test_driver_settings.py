"""Driver settings and parameter sets in the model."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.robot_settings.driver_settings import LIMITS
from thorvaldc.model import Robot
from thorvaldc.model.model_json import from_json, to_json
from thorvaldc.runtime import run_time_parameters as parameters
from thorvaldc.runtime.calculators import Noise
from thorvaldc.schema import inlined

MODULES = """
modules:
  frame: {type: frame/tube_rectangular}
  l: {type: assembly/fixed_drive, mount: frame.rear_left, params: {wheel: wheel/greenhouse_double}}
  r: {type: assembly/fixed_drive, mount: frame.rear_right, params: {wheel: wheel/greenhouse_double}}
  a: {type: caster/swivel, mount: frame.front_left}
  b: {type: caster/swivel, mount: frame.front_right}
"""


def compiled(folder: Path, text: str) -> Compilation:
    file = folder / "robot.yaml"
    file.write_text(f"thorvaldc: 1\nname: two\n{text}{MODULES}")
    return compile_file(file)


def robot(folder: Path, text: str) -> Robot:
    compilation = compiled(folder, text)
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


def test_parameter_set_is_driver_settings_with_its_changes(tmp_path: Path) -> None:
    model = robot(
        tmp_path,
        "driver: {max_linear_velocity: 0.6 m/s, noise: {angle: 1 deg, speed_ratio: 0.02}}\n"
        "parameter_sets:\n"
        "  rail: {radii: rail, max_angular_velocity: 20 deg/s, noise: {speed_ratio: 0.03}}\n"
        "  slow: {max_linear_velocity: 0.1 m/s}\n",
    )
    rail, slow = model.parameter_sets
    assert (rail.name, rail.radii, slow.name, slow.radii) == ("rail", "rail", "slow", None)
    assert rail.driver.max_linear_velocity == 0.6
    assert rail.driver.max_angular_velocity == pytest.approx(0.349066, abs=1e-6)
    assert dict(rail.driver.noise) == pytest.approx({"angle": 0.0174533, "speed_ratio": 0.03})
    assert dict(model.driver.noise) == pytest.approx({"angle": 0.0174533, "speed_ratio": 0.02})
    assert slow.driver == dataclasses.replace(model.driver, max_linear_velocity=0.1)
    assert from_json(to_json(model)) == model


def test_lasting_errors_may_be_zero(tmp_path: Path) -> None:
    model = robot(
        tmp_path,
        "driver: {noise: {radius_error: 0.2 %, steering_offset_error: 0.1 deg}}\n"
        "parameter_sets: {exact: {noise: {radius_error: 0, steering_offset_error: 0}}}\n",
    )
    noise = dict(model.driver.noise)
    assert noise == pytest.approx({"radius_error": 0.002, "steering_offset_error": 0.00174533})
    exact = dict(model.parameter_sets[0].driver.noise)
    assert exact == {"radius_error": 0.0, "steering_offset_error": 0.0}


def test_smaller_radii_lower_the_limits(tmp_path: Path) -> None:
    model = robot(tmp_path, "parameter_sets: {rail: {radii: rail}}\n")
    (rail,) = model.parameter_sets
    share = 90 / 125
    assert rail.driver.max_linear_velocity == pytest.approx(
        share * model.driver.max_linear_velocity
    )
    assert rail.driver.max_angular_acceleration == pytest.approx(
        share * model.driver.max_angular_acceleration
    )


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("parameter_sets:\n  rail: {radii: rial}\n", "parameter-set-radii", 4),
        ("parameter_sets:\n  x: {max_linear_velocity: 9 m/s}\n", "driver-limit-too-high", 4),
        ("parameter_sets:\n  x: {max_linear_velocity: -1 m/s}\n", "size-not-positive", 4),
        ("parameter_sets:\n  x: {noise: {angle: 0}}\n", "size-not-positive", 4),
        ("parameter_sets:\n  x: {max_linear_velocity: 1 m}\n", "wrong-dimension", 4),
        ("parameter_sets:\n  x: {radius: 1 m}\n", "unknown-key", 4),
        ("driver:\n  noise: {speed: 1}\n", "unknown-key", 4),
    ],
)
def test_errors_of_a_parameter_set_have_its_lines(
    tmp_path: Path, text: str, code: str, line: int
) -> None:
    compilation = compiled(tmp_path, text)
    lines_by_code = [(d.code.name, d.span.line) for d in compilation.report if d.span]
    assert (code, line) in lines_by_code
    assert (compilation.model is None) == any(
        d.code.severity == "error" for d in compilation.report
    )


def test_setting_names_equal_those_of_the_runtime() -> None:
    assert tuple(
        inlined("robot")["properties"]["driver"]["properties"]["noise"]["properties"]
    ) == tuple(field.name for field in dataclasses.fields(Noise))
    assert tuple(LIMITS) == tuple(parameters.LIMITS)
