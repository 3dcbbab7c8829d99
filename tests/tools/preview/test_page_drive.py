"""The simulated robot of a page without a thread: which control cycles run."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tests.examples import example_robot
from thorvaldc.tools.preview import page_drive


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


def test_late_cycles_are_made_up_for_but_not_those_of_a_long_break(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(page_drive, "time", SimpleNamespace(monotonic=clock.monotonic))
    messages: list[dict[str, Any]] = []
    drive = page_drive.PageDrive(example_robot("4wd4ws_wide"), "", messages.append)

    def simulated(steps: int, step: float) -> float:
        """Returns the simulated time (s) that passes with the calls of a timer."""
        times = [message["time"] for message in messages if message["kind"] == "state"]
        for _ in range(steps):
            clock.now += step
            assert drive.advance()
        states = [message for message in messages if message["kind"] == "state"]
        return float(states[-1]["time"] - (times[-1] if times else 0.0))

    in_time = simulated(100, 0.01)
    assert in_time == pytest.approx(1.0, abs=0.06)
    drive.move(1.0, 0.0, 0.0)
    clock.now += 0.1  # the thread was busy
    assert simulated(20, 0.01) == pytest.approx(0.3, abs=0.06)
    clock.now += 60.0  # the computer slept
    assert simulated(100, 0.01) == pytest.approx(1.0 + page_drive.LONGEST_LAG, abs=0.1)
    drive.close()
    assert not drive.advance()
    assert messages[-1] == {"kind": "drive", "on": False, "message": ""}


def test_a_fault_ends_the_drive_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise RuntimeError("no physics")

    monkeypatch.setattr(page_drive, "MujocoScene", fail)
    messages: list[dict[str, Any]] = []
    drive = page_drive.PageDrive(example_robot("4wd4ws_wide"), "", messages.append)
    assert not drive.advance()
    text = "the simulation ended: no physics"
    assert messages == [{"kind": "drive", "on": False, "message": text}]
