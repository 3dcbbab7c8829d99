"""The status lines of teleoperation fit a terminal of 80 columns."""

from __future__ import annotations

from typing import Any

import pytest

from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.teleop_loop import status_lines

STATE: dict[str, Any] = {
    "mode": "fault",
    "source": "teleop_joy",
    "locks": ["safety_stop", "another_lock_with_a_long_name"],
    "in_force": {"vx": -10.0, "vy": -10.0, "wz": -10.0},
    "pose": {"x": -1000.0, "y": -1000.0, "yaw": -3.0},
    "fault": "the process of the simulated bus is 0.7 s late: the machine is too busy; " * 2,
    "held": "",
    "limited_by": "max_angular_velocity 1.541 rad/s",
}


def test_the_lines_fit_80_columns_and_a_fault_has_lines_of_its_own() -> None:
    lines = status_lines(STATE, Twist(-10.0, -10.0, -10.0), 1.0, "a message " * 8)
    assert max(map(len, lines)) < 80
    fault = next(i for i, line in enumerate(lines) if line.startswith("       FAULT the process"))
    assert "locked: safety_stop" in " ".join(lines[:fault])
    message = next(i for i, line in enumerate(lines) if line.startswith("       a message"))
    assert "busy" in " ".join(lines[fault:message])
    assert lines[2].endswith("limited by max_angular_velocity 1.541 rad/s")


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        ({"supervisor": "active", "held": ""}, "active  drives: nobody"),
        ({"supervisor": "homing", "held": "homing"}, "homing  drives: nobody"),
        ({"supervisor": "ready", "held": "disarmed"}, "ready  drives: nobody  disarmed: press g"),
        ({"supervisor": "ready", "held": "paused"}, "ready  drives: nobody  held: paused"),
        ({"mode": "fault", "held": "paused", "fault": "late"}, "fault  drives: nobody"),
    ],
)
def test_why_the_robot_is_held_is_said_once(state: dict[str, str], expected: str) -> None:
    shown = {**STATE, "source": "", "locks": [], "fault": "", "limited_by": "", **state}
    assert status_lines(shown, None, 1.0, "")[3].strip() == expected


def test_a_command_that_is_not_followed_is_shown_unless_a_limit_explains_it() -> None:
    text = (
        "for 7 s, the robot drives (0.3 m/s, 0 m/s, 0 rad/s) instead of (0.6 m/s, 0 m/s, 0 rad/s)"
    )
    state = {**STATE, "not_followed": text}
    assert text not in " ".join(" ".join(status_lines(state, None, 1.0, "")).split())
    state["limited_by"] = ""
    lines = status_lines(state, None, 1.0, "")
    assert text in " ".join(" ".join(lines).split())
    assert max(map(len, lines)) < 80
