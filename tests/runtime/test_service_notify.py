"""Messages of a run to the service manager: sd_notify(3), and the file of an empty battery."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402
from thorvaldc.model.robot_computer import POWER_OFF, Computer
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.service_notify import LOW_TIME, LowBattery, ServiceNotifier
from thorvaldc.simulation.bus.fault_injection import FaultInjector


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as stream:
        stream.bind(str(tmp_path / "notify"))
        stream.setblocking(False)
        yield stream


def received(manager: socket.socket) -> list[str]:
    messages = []
    with contextlib.suppress(BlockingIOError):
        while True:
            messages.append(manager.recv(100).decode())
    return messages


def test_each_quarter_of_the_watchdog_time_has_a_message(manager: socket.socket) -> None:
    environment = {"NOTIFY_SOCKET": str(manager.getsockname()), "WATCHDOG_USEC": "2000000"}
    notifier = ServiceNotifier(environment)
    for cycle in range(101):
        notifier.cycle_done(0.02 * cycle)  # 2 s
    assert received(manager) == ["READY=1\nWATCHDOG=1", *["WATCHDOG=1"] * 4]
    notifier.close()
    notifier.cycle_done(9.0)
    assert received(manager) == ["STOPPING=1"]


@pytest.mark.parametrize(
    "changes",
    [
        {"NOTIFY_SOCKET": ""},  # no service manager
        {"WATCHDOG_PID": str(os.getpid() + 1)},  # that of the parent process
        {"NOTIFY_SOCKET": "/nowhere/notify"},
    ],
)
def test_without_a_service_manager_nothing_is_sent(
    manager: socket.socket, changes: dict[str, str]
) -> None:
    environment = {"NOTIFY_SOCKET": str(manager.getsockname()), "WATCHDOG_USEC": "2000000"}
    notifier = ServiceNotifier(environment | changes)
    notifier.cycle_done(0.0)
    notifier.close()
    assert received(manager) == []


def test_without_a_watchdog_only_the_start_is_reported(manager: socket.socket) -> None:
    notifier = ServiceNotifier({"NOTIFY_SOCKET": str(manager.getsockname())})
    for cycle in range(100):
        notifier.cycle_done(float(cycle))
    assert received(manager) == ["READY=1\nWATCHDOG=1"]
    notifier.close()


class Service:
    """A running robot whose service reads its batteries after each cycle."""

    def __init__(self, folder: Path) -> None:
        robot = cia402()
        self.rig = Rig(replace(robot, computer=Computer("robot", "thorvaldc", power_off=0.03)))
        self.file = folder / POWER_OFF
        self.low_battery = LowBattery(self.rig.robot, {"RUNTIME_DIRECTORY": str(folder)})
        self.rig.drive(Twist(0.5, 0.0, 0.0), 1.0)

    def inject(self, kind: str, **fields: float) -> None:
        fault = BusFault(kind, "main", "battery", 0.0, None, SPAN, **fields)  # type: ignore[arg-type]
        FaultInjector(self.rig.simulated, BusFaults(())).inject(fault)

    def run(self, seconds: float) -> bool:
        """Runs control cycles, and returns whether the computer is to be switched off."""
        end = self.rig.now + seconds
        while self.rig.now < end:
            self.rig.run(self.rig.base.period)
            self.low_battery.cycle_done(self.rig.driven)
        return self.file.exists()


def test_the_computer_is_switched_off_a_minute_after_the_stop(tmp_path: Path) -> None:
    service = Service(tmp_path)
    assert not service.run(2.0)
    service.inject("battery_charge", charge=0.02)
    assert not service.run(LOW_TIME - 1.0)
    assert service.rig.speed() == 0.0
    assert service.run(8.0)
    texts = [event.text for event in service.rig.driven.events]
    assert texts.count("the computer is switched off: the battery is empty") == 1


def test_a_battery_that_is_charged_or_silent_is_not_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service(tmp_path)
    service.inject("battery_charge", charge=0.02)
    assert not service.run(LOW_TIME - 5.0)
    service.inject("battery_charge", charge=0.04)
    assert not service.run(2.0)
    service.inject("battery_charge", charge=0.02)
    assert not service.run(LOW_TIME - 5.0)
    reported = service.rig.base.sources
    charging = lambda: [replace(source, current=-5.0) for source in reported()]  # noqa: E731
    with monkeypatch.context() as patch:
        patch.setattr(service.rig.base, "sources", charging)
        assert not service.run(2.0 * LOW_TIME)
    service.inject("mute")
    assert not service.run(3.0 * LOW_TIME)


def test_a_folder_that_cannot_be_written_is_one_event_per_minute(tmp_path: Path) -> None:
    service = Service(tmp_path / "missing")
    service.inject("battery_charge", charge=0.02)
    assert not service.run(1.5 * LOW_TIME)
    texts = [event.text for event in service.rig.driven.events]
    assert sum(1 for text in texts if "is switched off" in text) == 1
