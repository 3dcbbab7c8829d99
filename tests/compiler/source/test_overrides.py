"""New values for entries of robot, fleet and scenario files, by their dotted paths."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from thorvaldc.compiler.pipeline import CompileError, compile_file, load, load_fleet

EXAMPLES = Path(__file__).parents[3] / "examples"
WIDE = EXAMPLES / "4wd4ws_wide/robot.yaml"
FLEET = EXAMPLES / "fleet_of_four/fleet.yaml"
SCENARIO = EXAMPLES / "scenarios/field_edge.yaml"


def errors(path: Path, values: dict[str, object]) -> list[str]:
    report = compile_file(path, set=values).report
    return [f"{d.span.file}: {d.code.name}" for d in report.errors if d.span is not None]


def test_a_value_of_a_robot_is_replaced_and_a_missing_one_added() -> None:
    width = {"modules.frame.params.width": "1.50 m", "driver.rate": "20 Hz"}
    robot = load(WIDE, set=width)
    assert robot.driver.rate == 20.0
    pairs = zip(robot.wheels, load(WIDE).wheels, strict=True)
    assert [abs(b.y) - abs(a.y) for a, b in pairs] == pytest.approx([0.05] * 4)
    assert load(WIDE).driver.rate != 20.0


def test_values_of_python_are_those_of_yaml() -> None:
    whole = {"type": "sensor/imu", "mount": {"parent": "frame", "xyz": [0, 0, 0.1]}}
    robot = load(WIDE, set={"modules.second": whole, "modules.io.can": 21})
    assert "second" in {sensor.module for sensor in robot.sensors}
    with pytest.raises(TypeError, match=r"--set modules\.io\.can: expected a text, a number"):
        load(WIDE, set={"modules.io.can": object()})
    with pytest.raises(TypeError, match="set: expected values by their paths"):
        load(WIDE, set=["modules.io.can=21"])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"driver.rate": "5 kg"}, "--set driver.rate: wrong-dimension"),
        ({"drivr.rate": "5 Hz"}, "--set drivr.rate: unknown-key"),
        ({"modules.frame.params.widht": "1 m"}, "--set modules.frame.params.widht: param-unknown"),
        ({"name.first": "x"}, "--set name.first: variation-path"),
        ({"modules.battery_left.mount.xyz.3": 1}, "--set modules.battery_left.mount.xyz.3: varia"),
    ],
)
def test_a_wrong_value_is_an_error_at_its_path(values: dict[str, object], expected: str) -> None:
    assert any(error.startswith(expected) for error in errors(WIDE, values))


def test_a_scenario_changes_itself_and_its_robots() -> None:
    values = {"world.friction": 0.4, "driver.rate": "20 Hz"}
    scenario = compile_file(SCENARIO, set=values).scenario
    assert scenario is not None
    assert {p.robot.driver.rate for p in scenario.fleet.placements} == {20.0}
    assert {p.robot.wheels[0].friction for p in scenario.fleet.placements} == {0.4}
    assert errors(SCENARIO, {"driver.rate": "5 kg"}) == ["--set driver.rate: wrong-dimension"]


def test_a_fleet_changes_its_robots() -> None:
    fleet = load_fleet(FLEET, set={"driver.rate": "20 Hz"})
    assert {placement.robot.driver.rate for placement in fleet.placements} == {20.0}


def test_the_hash_of_the_inputs_contains_the_values() -> None:
    values: list[dict[str, object] | None] = [None, {}, {"name": "a"}, {"name": "b"}]
    assert len({compile_file(WIDE, set=value).source_sha256 for value in values}) == 3


def test_a_compiled_model_has_no_paths(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match="compiled model"):
        load(tmp_path / "model.json", set={"name": "x"})
    with pytest.raises(CompileError):
        load(WIDE, set={"name": [1]})


def test_a_document_may_be_a_text_or_a_mapping() -> None:
    document = yaml.safe_load(WIDE.read_text(encoding="utf-8"))
    robot = load(WIDE, set={"driver.rate": "20 Hz"})
    for source in (WIDE.read_text(encoding="utf-8"), document):
        other = load(source, set={"driver.rate": "20 Hz"})
        assert [w.y for w in other.wheels] == [w.y for w in robot.wheels]
        assert (other.inertial.mass, other.driver) == (robot.inertial.mass, robot.driver)
    with pytest.raises(CompileError, match=r"document\.yaml:\d+:\d+: error\[TV211\]"):
        load({**document, "driver": {"rate": "5 kg"}})
    with pytest.raises(CompileError, match="expected a fleet, got a robot"):
        load_fleet(document)
