"""`sim --log` and `calibrate`."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot

TRUE = """\
thorvaldc: 1
robot: good
wheels:
  fl_wheel: {radius: 202 mm, steering_offset: 1 deg}
  fr_wheel: {radius: 199 mm, steering_offset: -0.5 deg}
"""


@pytest.fixture
def calibrated(thorvaldc: Command) -> str:
    """A robot with calibrated wheels; the wheels of `good.yaml` are not calibrated."""
    Path("true.yaml").write_text(TRUE, encoding="utf-8")
    Path("knows.yaml").write_text(GOOD + "calibration: true.yaml\n", encoding="utf-8")
    return "knows.yaml"


def test_a_calibration_is_estimated_and_included(thorvaldc: Command, calibrated: str) -> None:
    pytest.importorskip("mujoco")
    driven = thorvaldc("sim", calibrated, "--open-loop", "--log", "joints.csv")
    assert driven.status == 0, driven.err
    result = thorvaldc("calibrate", "joints.csv", "good.yaml", "-o", "calibration.yaml")
    assert result.status == 0, result.err
    fl = next(line for line in result.out.splitlines() if line.startswith("fl_wheel"))
    assert "+1.0" in fl or "+0.9" in fl
    # With the calibration, the robot agrees with the log.
    Path("again.yaml").write_text(GOOD + "calibration: calibration.yaml\n", encoding="utf-8")
    assert thorvaldc("check", "again.yaml").status == 0
    again = thorvaldc("calibrate", "joints.csv", "again.yaml", "--json")
    value = json.loads(again.out)
    offset = value["wheels"][0]["steering_offset"]
    assert offset["value"] == pytest.approx(0.0174533, abs=0.002)
    assert value["wheels"][1]["radius_ratio"]["value"] == pytest.approx(1.0, abs=1e-5)


def test_the_calibration_states_the_errors_that_remain(thorvaldc: Command, calibrated: str) -> None:
    pytest.importorskip("mujoco")
    thorvaldc("sim", calibrated, "--open-loop", "--log", "joints.csv")
    assert thorvaldc("calibrate", "joints.csv", "good.yaml", "-o", "first.yaml").status == 0
    first = noise_of("calibration: first.yaml")
    assert 5e-5 <= first["radius_error"] <= 1e-3
    assert math.radians(0.005) <= first["steering_offset_error"] <= math.radians(0.2)
    # The wheels alone do not show the scale of the four radii, each of which is 1 % uncertain.
    assert first["scale_error"] == pytest.approx(0.01 / math.sqrt(4))
    measured = ("sim", calibrated, "--open-loop", "--twist", "0.8,0,0", "--duration", "13")
    thorvaldc(*measured, "--log", "straight.csv")
    Path("has.yaml").write_text(GOOD + "calibration: first.yaml\n", encoding="utf-8")
    distance = ("--distance", "10.0 m", "-o", "second.yaml")
    result = thorvaldc("calibrate", "straight.csv", "has.yaml", *distance)
    assert result.status == 0, result.err
    second = noise_of("calibration: second.yaml")
    assert 1e-3 <= second["scale_error"] <= 3e-3  # a tape measures 10 m to 1 cm
    assert second["radius_error"] == pytest.approx(first["radius_error"])


def test_the_robot_file_has_precedence_over_the_errors_that_remain(
    thorvaldc: Command, calibrated: str
) -> None:
    noise = "noise: {radius_error: 0.1 %, steering_offset_error: 0.02 deg}\n"
    Path("c.yaml").write_text(TRUE.replace("wheels:", noise + "wheels:"), encoding="utf-8")
    stated = "driver: {noise: {radius_error: 0.4 %}}\ncalibration: c.yaml"
    assert noise_of("calibration: c.yaml")["radius_error"] == 0.001
    assert noise_of(stated)["radius_error"] == 0.004
    assert noise_of(stated)["steering_offset_error"] == pytest.approx(math.radians(0.02))


def noise_of(sections: str) -> dict[str, float]:
    """Returns the noise of the robot with further sections."""
    Path("noisy.yaml").write_text(f"{GOOD}{sections}\n", encoding="utf-8")
    model = compile_file(Path("noisy.yaml")).model
    assert isinstance(model, Robot)
    return dict(model.driver.noise)


def test_scenario_without_speed_control(thorvaldc: Command, calibrated: str) -> None:
    """Wheels of wrong sizes turn at different speeds only without speed control."""
    pytest.importorskip("mujoco")
    scenario = (
        f"thorvaldc: 1\nscenario: straight\nrobots: {{r: {{robot: {calibrated}}}}}\n"
        "duration: 8 s\nscript: [{at: 0, vx: 0.5 m/s}]\n"
        "faults: [{type: radius_error, wheel: rl_wheel, error: 2 %, at: 0}]\n"
    )
    Path("plain.yaml").write_text(scenario, encoding="utf-8")
    Path("open.yaml").write_text(scenario + "open_loop: true\n", encoding="utf-8")
    texts = []
    for arguments in (("plain.yaml",), ("plain.yaml", "--open-loop"), ("open.yaml",)):
        driven = thorvaldc("sim", *arguments, "--log", "joints.csv")
        assert driven.status == 0, driven.err
        texts.append(Path("joints.csv").read_text(encoding="utf-8"))
    assert texts[1] == texts[2]
    assert texts[0] != texts[1]
    result = thorvaldc("calibrate", "joints.csv", "good.yaml")
    assert "calibration-forced" not in result.err


def test_only_a_calibration_file_is_overwritten(thorvaldc: Command, calibrated: str) -> None:
    thorvaldc("sim", calibrated, "--ideal", "--open-loop", "--log", "joints.csv")
    for path in ("true.yaml", "new.yaml"):
        assert thorvaldc("calibrate", "joints.csv", "good.yaml", "-o", path).status == 0
    text_before = Path("good.yaml").read_text(encoding="utf-8")
    refused = thorvaldc("calibrate", "joints.csv", "good.yaml", "-o", "good.yaml")
    assert refused.status == 3
    assert "no calibration" in refused.err
    assert Path("good.yaml").read_text(encoding="utf-8") == text_before
    assert thorvaldc("calibrate", "joints.csv", "good.yaml", "-o", "none/c.yaml").status == 3
    assert not [path for path in Path().iterdir() if path.name.endswith(".new")]


def test_a_log_that_determines_nothing_writes_no_file(thorvaldc: Command, calibrated: str) -> None:
    thorvaldc("sim", "good.yaml", "--ideal", "--log", "joints.csv")
    result = thorvaldc("calibrate", "joints.csv", "good.yaml", "-o", "calibration.yaml")
    assert result.status == 1
    assert "calibration-forced" in result.err
    assert not Path("calibration.yaml").exists()


@pytest.mark.parametrize(
    "text", ["", "time\n", "time,fl_drive_axle.position\n", "\n\n", "a,b\n1,2\n"]
)
def test_invalid_logs_are_errors(thorvaldc: Command, text: str) -> None:
    Path("joints.csv").write_text(text, encoding="utf-8")
    result = thorvaldc("calibrate", "joints.csv", "good.yaml")
    assert result.status == 1
    assert "error[TV821]" in result.err or "error[TV831]" in result.err
    assert result.out == ""


def test_log_with_a_header_alone(thorvaldc: Command, calibrated: str) -> None:
    thorvaldc("sim", "good.yaml", "--ideal", "--duration", "1", "--log", "joints.csv")
    lines = Path("joints.csv").read_text(encoding="utf-8").splitlines()
    for count in (1, 2, 3):
        Path("joints.csv").write_text("\n".join(lines[:count]) + "\n", encoding="utf-8")
        result = thorvaldc("calibrate", "joints.csv", "good.yaml")
        assert result.status == 1
        assert "joint-log-short" in result.err


def test_values_that_the_log_does_not_determine_are_kept(
    thorvaldc: Command, calibrated: str
) -> None:
    thorvaldc("sim", calibrated, "--ideal", "--open-loop", "--log", "joints.csv")
    kept = TRUE.replace("202 mm, steering_offset: 1 deg", "203 mm, steering_offset: 2 deg")
    Path("old.yaml").write_text(kept, encoding="utf-8")
    Path("has.yaml").write_text(GOOD + "calibration: old.yaml\n", encoding="utf-8")
    assert thorvaldc("calibrate", "joints.csv", "has.yaml", "-o", "old.yaml").status == 0
    text = Path("old.yaml").read_text(encoding="utf-8")
    # Wheels that turn exactly as commanded determine no radius.
    assert "radius: 203.0000 mm  # as before" in text
    assert "steering_offset: 1.0000 deg  # +-" in text


def test_unknown_parameter_set(thorvaldc: Command, calibrated: str) -> None:
    thorvaldc("sim", calibrated, "--ideal", "--open-loop", "--log", "joints.csv")
    result = thorvaldc("calibrate", "joints.csv", "good.yaml", "--parameters", "rails")
    assert result.status == 1
    assert "parameter-set-unknown" in result.err


@pytest.mark.parametrize("distance", ["ten", "10 kg", "-3", "0", "nan"])
def test_bad_distance(thorvaldc: Command, distance: str) -> None:
    assert thorvaldc("calibrate", "j.csv", "good.yaml", f"--distance={distance}").status == 2


def test_missing_files_and_robots_with_errors(thorvaldc: Command) -> None:
    assert thorvaldc("calibrate", "none.csv", "good.yaml").status == 1
    assert thorvaldc("calibrate", "none.csv", "bad.yaml").status == 1
    assert thorvaldc("sim", "good.yaml", "--ideal", "--log", "none/joints.csv").status == 3


def test_a_calibration_joins_the_report_of_the_first_motion(
    thorvaldc: Command, calibrated: str
) -> None:
    pytest.importorskip("mujoco")
    assert thorvaldc("sim", calibrated, "--open-loop", "--log", "joints.csv").status == 0
    refused = thorvaldc("calibrate", "joints.csv", "good.yaml", "--report")
    assert refused.status == 2
    assert "good.commission.json" in refused.err
    content = {"format": "thorvaldc-commission", "version": 1, "robot": "good", "model": "0"}
    content |= {"program": "1", "date": "today", "operator": "Kari", "interruption": ""}
    content |= {"passed": True, "nodes": [], "findings": [], "motors": [], "calibration": None}
    Path("good.commission.json").write_text(json.dumps(content), encoding="utf-8")
    result = thorvaldc("calibrate", "joints.csv", "good.yaml", "--report")
    assert result.status == 0, result.err
    report = json.loads(Path("good.commission.json").read_text(encoding="utf-8"))
    assert report["operator"] == "Kari"
    assert report["calibration"]["remaining_errors"]
    page = Path("good.commission.html").read_text(encoding="utf-8")
    assert ">Calibration</h2>" in page
    assert "fl_wheel" in page
