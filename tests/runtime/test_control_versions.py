"""Programs of different versions on one control channel."""

from __future__ import annotations

import re
import threading

import pytest

from tests.runtime.test_control_channel import RunningDriver, running
from thorvaldc.runtime import control_channel, driven_robot
from thorvaldc.runtime.control_channel import ControlClient

__all__ = ["running"]


def other_version(running: RunningDriver, version: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """Returns what a client of a version says about the driver."""
    texts: list[str] = []

    def ask() -> None:
        client = ControlClient("r")
        texts.append(client.other_version())
        client.close()

    monkeypatch.setattr(control_channel, "program_version", lambda: version)
    thread = threading.Thread(target=ask)
    thread.start()
    while thread.is_alive():
        running.cycles()
        thread.join(0.001)
    return texts[0]


def test_programs_of_different_versions_both_say_so(
    running: RunningDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driven_robot, "program_version", lambda: "0.1.0")
    assert other_version(running, "0.1.0", monkeypatch) == ""
    assert running.robot.other_versions == {}
    said = other_version(running, "0.2.0", monkeypatch)
    assert said.startswith("the driver `r` is thorvaldc 0.1.0, this program is thorvaldc 0.2.0;")
    (heard,) = running.robot.other_versions.values()
    assert re.match(r"connection 2( \(process \d+\))? is thorvaldc 0\.2\.0, this program", heard)
    assert running.robot.events[-1].text == heard
    # A program that calls again, or with any text, fills neither the terminal nor the memory.
    for number in range(100):
        running.services.call("hello", {"version": f"9.{number % 50}" * 50}, running.now)
    assert len(running.robot.other_versions) == driven_robot.MOST_VERSIONS
    assert max(map(len, running.robot.other_versions)) == 40


def test_a_driver_without_a_hello_is_older(
    running: RunningDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    del running.services._services["hello"]
    said = other_version(running, "0.2.0", monkeypatch)
    assert said.startswith("the driver `r` is thorvaldc older than 0.1.0, this program is")
