"""The installed service under a real systemd: boot, restarts, the watchdog and the end.

Its bus is simulated: the program at the place of the environment replaces the CAN interface; the
unit is the one that `thorvaldc install` writes.
"""

from __future__ import annotations

from typing import Any

import pytest

from tests.container import in_container


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What happened in the container."""
    module = "tests.tools.computer.service_session"
    return in_container(module, tmp_path_factory.mktemp("container"))


pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("container")]


def test_the_file_of_another_robot_is_refused(record: dict[str, Any]) -> None:
    status, text = record["other"]
    assert status == 1
    assert "error[TV862] bus-wrong-robot: the device with the id 1 on the bus `main` is" in text
    assert "other.yaml:13:" in text
    assert record["changed"] == []
    status, text = record["same"]
    assert (status, "note: 5 of 5 devices on the bus `main` are as in the file" in text) == (
        0,
        True,
    )


def test_the_service_starts_disarmed_as_its_user(record: dict[str, Any]) -> None:
    status, text = record["install"]
    assert (status, "does not start" in text) == (0, False)
    assert record["process"][1].split() == ["robot", "FF", "20"]
    started = record["started"]
    assert (started["armed"], started["moved"], started["fault"]) == (False, False, "")
    assert record["status"][0] == 0
    assert "service active (running)" in record["status"][1]


def test_its_page_is_served_beside_the_control_cycle(record: dict[str, Any]) -> None:
    assert '"driver", ' in record["page"]
    assert record["page_process"][1].split() == ["robot", "TS"]


def test_an_empty_battery_switches_the_computer_off(record: dict[str, Any]) -> None:
    assert sorted(record["watch"][1].split()) == ["ActiveState=active", "Triggers=poweroff.target"]
    assert record["asked"] == [3, "inactive\n"]  # before the service asked for it


def test_an_installation_disturbs_no_driver(record: dict[str, Any]) -> None:
    """Armed, the robot keeps its version; disarmed, its bus belongs to the driver."""
    status, text = record["armed"]
    assert (status, "the robot is armed: thorvaldc call" in text) == (3, True)
    status, text = record["running"]
    assert status == 0
    assert "were not compared with the file: another `thorvaldc can` or `thorvaldc run`" in text


def test_a_file_with_errors_leaves_the_last_build_in_use(record: dict[str, Any]) -> None:
    assert record["restart"][0] == 0
    assert "modulse" in record["errors"][1]


def test_each_end_of_the_driver_stops_the_wheels(record: dict[str, Any]) -> None:
    """Killed or stopped five times, some with frozen reports, the robot is at rest, and starts
    disarmed without moving."""
    ends = record["ends"]
    assert [end["how"] for end in ends] == ["SIGKILL", "SIGKILL", "SIGSTOP", "SIGSTOP", "SIGKILL"]
    assert [(end["armed"], end["moved"]) for end in ends] == [(False, False)] * 5
    assert record["at_last"] == {"result": "signal", "speed": 0.0}
    assert record["failed"][0] == 1
    assert "service failed" in record["failed"][1]


def test_a_removal_leaves_nothing(record: dict[str, Any]) -> None:
    assert (record["uninstall"][0], record["left"]) == (0, [])
