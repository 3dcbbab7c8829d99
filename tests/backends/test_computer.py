"""The target `computer`: names of interfaces and ports, and the services of a robot's computer."""

from __future__ import annotations

import configparser
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot

TWO_BUSES = GOOD.replace(
    "modules:\n", "buses: {left: {bitrate: 250 kbit/s}, right: {bitrate: 1 Mbit/s}}\nmodules:\n", 1
)
for _name, _bus in (("fl", "left"), ("fr", "right"), ("rl", "left"), ("rr", "right")):
    _id = ("fl", "fr", "rl", "rr").index(_name) + 1
    TWO_BUSES = TWO_BUSES.replace(f"can: {_id}}}", f"can: {{bus: {_bus}, id: {_id}}}}}", 1)
TWO_BUSES = TWO_BUSES.replace("0.07]}, can: 1}", "0.07]}, can: {bus: left, id: 7}}")


def files_of(folder: Path, text: str, name: str = "good.yaml") -> tuple[dict[str, str], list[str]]:
    """Returns the files of the target, and the diagnostics of the robot and of the target."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    report = Report()
    files = emit(compilation.model, ["computer"], report)
    codes = [d.code.name for d in (*compilation.report, *report)]
    texts = {
        name.removeprefix("computer/"): data.decode()
        for name, data in files.items()
        if name.startswith("computer/")
    }
    return texts, codes


def sections(text: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    return parser


def test_one_bus_needs_no_section(tmp_path: Path) -> None:
    files, _ = files_of(tmp_path, GOOD)
    link = sections(files["network/50-good-can_main.link"])
    assert dict(link["Match"]) == {"Type": "can"}  # the only adapter
    assert link["Link"]["Name"] == "can_main"
    network = sections(files["network/50-good-can_main.network"])
    assert dict(network["CAN"]) == {"BitRate": "500000"}  # no RestartSec: down after bus-off
    service = sections(files["systemd/thorvaldc-good.service"])["Service"]
    assert service["User"] == "robot"
    assert "--bus socketcan:can_main --name" in service["ExecStart"]
    assert service["ExecStartPre"].startswith("-")  # an error leaves the last build in use
    assert service["ProtectSystem"] == "strict"  # it writes below its StateDirectory alone
    assert service["StateDirectory"] == "thorvaldc/good"
    assert service["RuntimeDirectory"] == "thorvaldc/good"
    assert not any(path.startswith("udev") for path in files)


def test_each_bus_has_its_adapter_and_bit_rate(tmp_path: Path) -> None:
    section = (
        "computer:\n  user: rob\n  can:\n    left: {serial: A1}\n"
        "    right: {path: 'pci-0000:00:14.0-usb-0:2:1.0', interface: can-r}\n"
    )
    files, codes = files_of(tmp_path, TWO_BUSES + section)
    assert "computer-adapter" not in codes
    left = files["network/50-good-can_left.link"]
    assert "Property=ID_SERIAL_SHORT=A1\n" in left
    right = files["network/50-good-can-r.link"]
    assert "Property=ID_PATH=pci-0000:00:14.0-usb-0:2:1.0\n" in right
    assert "BitRate=250000" in files["network/50-good-can_left.network"]
    assert "BitRate=1000000" in files["network/50-good-can-r.network"]
    unit = files["systemd/thorvaldc-good.service"]
    assert "--bus left=socketcan:can_left,right=socketcan:can-r" in unit
    assert (
        r"Wants=sys-subsystem-net-devices-can_left.device sys-subsystem-net-devices-can\x2dr"
        in (unit)
    )


def test_an_unknown_adapter_of_several_gets_no_name(tmp_path: Path) -> None:
    """A rule without a device would give both adapters one name."""
    files, codes = files_of(tmp_path, TWO_BUSES + "computer: {can: {left: {serial: A1}}}\n")
    assert codes.count("computer-adapter") == 1
    assert "network/50-good-can_left.link" in files
    assert "network/50-good-can_right.link" not in files


def test_ports_and_joystick_get_names(tmp_path: Path) -> None:
    section = "computer: {ports: {lidar: {serial: L7}}, joystick: {serial: J1}}\n"
    files, _ = files_of(tmp_path, GOOD + section)
    head, lidar, joystick = files["udev/70-good.rules"].splitlines()
    assert head.startswith("#")
    assert lidar == (
        'ACTION!="remove", SUBSYSTEM=="tty", ENV{ID_SERIAL_SHORT}=="L7", SYMLINK+="lidar", '
        'GROUP="robot", MODE="0660"'
    )
    assert 'KERNEL=="js[0-9]*", ENV{ID_SERIAL_SHORT}=="J1", SYMLINK+="joystick"' in joystick


def test_ros_starts_the_launch_file_of_the_package(tmp_path: Path) -> None:
    section = "computer: {ros: {workspace: /opt/ws, domain: 7, middleware: rmw_zenoh_cpp}}\n"
    files, _ = files_of(tmp_path, GOOD + section)
    unit = files["systemd/thorvaldc-good.service"]
    assert (
        "ExecStart=/bin/bash -c 'source /opt/ros/jazzy/setup.bash && source /opt/ws/install/"
        "setup.bash && exec ros2 launch good robot.launch.py bus:=socketcan:can_main'\n"
    ) in unit
    assert "Environment=ROS_DOMAIN_ID=7\n" in unit
    assert "Environment=RMW_IMPLEMENTATION=rmw_zenoh_cpp\n" in unit
    assert "Environment=ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET\n" in unit
    assert "ROS_STATIC_PEERS" not in unit
    # A service that restarts for months does not fill the disk.
    assert "/var/lib/thorvaldc/good/log - - - 14d\n" in files["tmpfiles/50-good.conf"]


def test_discovery_and_time(tmp_path: Path) -> None:
    section = (
        "computer: {time_servers: [10.0.0.1, ntp.farm.example], ros: {workspace: /opt/ws,"
        " discovery: localhost, peers: [10.0.0.20, laptop.local]}}\n"
    )
    files, _ = files_of(tmp_path, GOOD + section)
    unit = files["systemd/thorvaldc-good.service"]
    assert "Environment=ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST\n" in unit
    assert "Environment=ROS_STATIC_PEERS=10.0.0.20;laptop.local\n" in unit
    time = sections(files["time/50-good.conf"])["Time"]
    assert time["NTP"] == "10.0.0.1 ntp.farm.example"


@pytest.mark.parametrize("setting", ["discovery: localhost", "peers: [10.0.0.20]"])
def test_zenoh_has_its_discovery_elsewhere(tmp_path: Path, setting: str) -> None:
    section = f"computer: {{ros: {{workspace: /opt/ws, middleware: rmw_zenoh_cpp, {setting}}}}}\n"
    path = tmp_path / "good.yaml"
    path.write_text(GOOD + section, encoding="utf-8")
    (error,) = compile_file(path).report.errors
    assert (error.code.name, setting.split(":")[0] in error.message) == ("conflicting-keys", True)


def test_the_service_has_the_page_of_the_driver(tmp_path: Path) -> None:
    files, _ = files_of(tmp_path, f"{GOOD}computer: {{status_port: 8080}}\n")
    start = sections(files["systemd/thorvaldc-good.service"])["Service"]["ExecStart"]
    assert start.endswith(" --name /run/thorvaldc/good/control --status-port 8080")
    path = tmp_path / "good.yaml"
    for section, code in (
        ("{status_port: 8080, ros: {workspace: /opt/ws}}", "conflicting-keys"),
        ("{status_port: 80}", "out-of-range"),
    ):
        path.write_text(f"{GOOD}computer: {section}\n", encoding="utf-8")
        (error,) = compile_file(path).report.errors
        assert (error.code.name, error.span.line) == (code, GOOD.count("\n") + 1)


@pytest.mark.parametrize("ros", ["", ", ros: {workspace: /opt/ws}"])
def test_an_empty_battery_switches_the_computer_off(tmp_path: Path, ros: str) -> None:
    files, _ = files_of(tmp_path, f"{GOOD}computer: {{power_off: 3 %{ros}}}\n")
    watch = sections(files["systemd/thorvaldc-good.path"])
    expected = {"PathExists": "/run/thorvaldc/good/power-off", "Unit": "poweroff.target"}
    assert dict(watch["Path"]) == expected
    service = sections(files["systemd/thorvaldc-good.service"])["Service"]
    assert service["RuntimeDirectory"] == "thorvaldc/good"
    files, _ = files_of(tmp_path, GOOD)
    assert not [name for name in files if name.endswith(".path")]


def test_a_peer_that_is_no_address_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "good.yaml"
    section = "computer: {ros: {workspace: /opt/ws, peers: ['a b; rm']}}\n"
    path.write_text(GOOD + section, encoding="utf-8")
    (error,) = compile_file(path).report.errors
    assert (error.code.name, error.span.line) == ("unknown-value", GOOD.count("\n") + 1)


def test_the_name_of_the_file_is_one_argument(tmp_path: Path) -> None:
    files, _ = files_of(tmp_path, GOOD, "my %robot $1.yaml")
    assert ' build "my %%robot $$1.yaml" --target can' in files["systemd/thorvaldc-good.service"]


def test_a_port_without_a_device_is_an_error(tmp_path: Path) -> None:
    """A rule without a device would rename all serial ports, and change their group."""
    path = tmp_path / "good.yaml"
    path.write_text(GOOD + "computer: {ports: {lidar: {}}}\n", encoding="utf-8")
    assert "wrong-length" in [d.code.name for d in compile_file(path).report.errors]
