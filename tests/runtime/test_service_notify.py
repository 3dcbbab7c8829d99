"""Messages of a run to the service manager: systemd's protocol of sd_notify(3)."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from thorvaldc.runtime.service_notify import ServiceNotifier


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
