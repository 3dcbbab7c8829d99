"""The ROS 2 driver of a sensor module: its values, and its mistakes with their places."""

from __future__ import annotations

import pytest

from tests.workshop import CART, EXPECTED, Workshop
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model.ros2_driver import Ros2Driver

SENSOR = """\
mount: {kinds: [clamp], link: body}
params:
  address: {type: text, default: "", description: Address., source: "chosen: for a test"}
  port: {type: text, default: "", description: Port., source: "chosen: for a test"}
links:
  body:
    parts: [{shape: {box: [0.1, 0.1, 0.1]}, mass: 1 kg, source: "chosen: for a test"}]
sensor:
  type: lidar_2d
  ros2_driver:
    package: scanner
    executable: scanner_node
    frame: frame_id
    topics: {scan: cloud/scan}
    ports: {device: "${port}"}
    parameters: {address: "${address}", rate: "${2 * 10 Hz}", start: 90 deg, retries: 3, raw: true}
    when: ${address != "" or port != ""}
"""
ROBOT = CART + "    part: {type: t/part, mount: body.front, params: {%s}}\n"


def driver(workshop: Workshop, params: str, head: str = "") -> Ros2Driver | None:
    workshop.module("t/part", SENSOR)
    (sensor,) = workshop.robot(ROBOT % params, head).sensors
    return sensor.ros2_driver


def problems(workshop: Workshop, module: str, params: str, head: str = "") -> list[Diagnostic]:
    workshop.module("t/part", module)
    reported = workshop.diagnostics(ROBOT % params, head)
    return [diagnostic for diagnostic in reported if diagnostic.code.name not in EXPECTED]


def test_a_driver_has_the_values_of_its_module(workshop: Workshop) -> None:
    """An address stays text; quantities are in SI; a whole number stays one."""
    stated = driver(workshop, "address: 192.168.0.10")
    assert stated is not None
    assert (stated.package, stated.executable, stated.frame) == (
        "scanner",
        "scanner_node",
        "frame_id",
    )
    assert stated.topics == (("scan", "cloud/scan"),)
    assert stated.ports == ()
    values = dict(stated.parameters)
    assert values == pytest.approx(values | {"rate": 20.0, "start": 1.5707963267948966})
    assert values["address"] == "192.168.0.10"
    assert type(values["retries"]) is int
    assert values["raw"] is True


def test_a_sensor_that_the_robot_file_does_not_reach_has_no_driver(workshop: Workshop) -> None:
    assert driver(workshop, "") is None


def test_a_serial_port_is_one_of_the_computer_or_a_path(workshop: Workshop) -> None:
    head = 'computer: {ports: {scanner: {serial: "1"}}}\n'
    for port in ("scanner", "/dev/ttyUSB1"):
        stated = driver(workshop, f"port: {port}", head)
        assert stated is not None
        assert stated.ports == (("device", port),)
    (unknown,) = problems(workshop, SENSOR, "port: scaner", head)
    assert unknown.code.name == "unknown-value"
    assert "no serial port `scaner`" in unknown.message
    assert "it has scanner" in unknown.message
    assert unknown.span is not None
    assert unknown.span.file.endswith("robot.yaml")


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("frame: frame_id", "frame: [a]", "wrong-type"),
        ("frame: frame_id", "frames: frame_id", "unknown-key"),
        ("package: scanner", "package: Scanner", "bad-id"),
        ("{scan: cloud/scan}", "{scan: 'cloud scan'}", "unknown-value"),
        ("{scan: cloud/scan}", "{scans: cloud/scan}", "unknown-key"),
        ("{scan: cloud/scan}", "{}", "wrong-length"),
        ("retries: 3", "retries: [3]", "wrong-type"),
        ('address: "${address}"', 'address: "${adress}"', "expression-name"),
        ("retries: 3", "device: /dev/ttyS0", "conflicting-keys"),
        ("retries: 3", "frame_id: laser", "conflicting-keys"),
        ("type: lidar_2d", "type: radar", "unknown-value"),
    ],
)
def test_a_mistake_is_reported_in_its_line(
    old: str, new: str, code: str, workshop: Workshop
) -> None:
    module = SENSOR.replace(old, new)
    codes = {d.code.name: d.span for d in problems(workshop, module, "address: 10.0.0.1")}
    assert code in codes, codes
    span = codes[code]
    assert span is not None
    assert span.file.endswith("t/part/module.yaml")
    # The workshop adds two lines; a driver without topics is reported where it begins.
    changed = 1 + module.splitlines().index(
        next(line for line in module.splitlines() if new in line)
    )
    driver_line = 1 + module.splitlines().index("  ros2_driver:")
    assert span.line - 2 in (changed, driver_line)


@pytest.mark.parametrize(
    ("topics", "codes"),
    [
        ("{data: imu}", []),
        ("{data_raw: imu}", []),
        ("{data_raw: imu, mag: mag}", []),
        ("{mag: mag}", ["missing-key"]),
        ("{scan: scan}", ["unknown-key", "missing-key"]),
    ],
)
def test_an_imu_needs_its_topic_or_the_input_of_the_filter(
    topics: str, codes: list[str], workshop: Workshop
) -> None:
    module = SENSOR.replace("lidar_2d", "imu").replace("{scan: cloud/scan}", topics)
    reported = problems(workshop, module, "address: 10.0.0.1")
    assert sorted(d.code.name for d in reported) == sorted(codes)
