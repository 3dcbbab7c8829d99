"""Keys command twists only while they are held."""

from __future__ import annotations

import pytest

from thorvaldc.cli.terminal import keys_of
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.teleop_loop import Limits
from thorvaldc.tools.teleoperation.keyboard import FIRST_HOLD, MOTIONS, REPEAT_HOLD, Keyboard

LIMITS = Limits(1.5, 2.0, True)


class Keys:
    """Keys at given times."""

    def __init__(self, limits: Limits = LIMITS, share: float = 1.0) -> None:
        self.waiting: list[str] = []
        self.keyboard = Keyboard(limits, self.read, share)

    def read(self) -> list[str]:
        result, self.waiting = self.waiting, []
        return result

    def type(self, text: str, now: float) -> list[str]:
        self.waiting += keys_of(text)
        return [request.service for request in self.keyboard.poll(now)]

    def at(self, now: float) -> Twist | None:
        self.keyboard.poll(now)
        return self.keyboard.twist(now)


@pytest.fixture
def keys() -> Keys:
    return Keys()


@pytest.mark.parametrize(
    ("typed", "twist"),
    [
        ("i", (1.5, 0, 0)),
        ("w", (1.5, 0, 0)),
        ("\x1b[A", (1.5, 0, 0)),
        ("\x1bOA", (1.5, 0, 0)),
        (",", (-1.5, 0, 0)),
        ("\x1b[B", (-1.5, 0, 0)),
        ("j", (0, 0, 2)),
        ("\x1b[D", (0, 0, 2)),
        ("d", (0, 0, -2)),
        ("l", (0, 0, -2)),
        ("u", (1.5, 0, 2)),
        ("o", (1.5, 0, -2)),
        ("m", (-1.5, 0, -2)),
        (".", (-1.5, 0, 2)),
        ("J", (0, 1.5, 0)),
        ("L", (0, -1.5, 0)),
        ("\x1b[1;2C", (0, -1.5, 0)),
        ("U", (1.5, 1.5, 0)),
        ("O", (1.5, -1.5, 0)),
        ("M", (-1.5, 1.5, 0)),
        (">", (-1.5, -1.5, 0)),
    ],
)
def test_every_key_has_its_motion(keys: Keys, typed: str, twist: tuple[float, ...]) -> None:
    keys.type(typed, 0.0)
    assert keys.at(0.0) == twist


def test_turning_right_while_backing_is_as_on_the_wheel() -> None:
    """``u`` and ``m`` drive the same arc, one forward, the other back."""
    for forward, back in (("u", "m"), ("o", ".")):
        assert tuple(-part for part in MOTIONS[forward]) == MOTIONS[back]


def test_a_key_pressed_once_drives_until_it_would_repeat(keys: Keys) -> None:
    keys.type("i", 0.0)
    assert keys.at(FIRST_HOLD) == (1.5, 0, 0)
    assert keys.at(FIRST_HOLD + 0.05) == ZERO_TWIST
    assert keys.at(FIRST_HOLD + 0.2) is None  # others may drive


@pytest.mark.parametrize("first", [0.25, 0.5, 0.66])
def test_a_held_key_drives_without_a_gap_and_stops_soon_after(keys: Keys, first: float) -> None:
    keys.type("i", 0.0)
    presses = [first + i / 30 for i in range(60)]
    now, last = 0.0, presses[-1]
    while now < last + REPEAT_HOLD - 0.02:
        while presses and presses[0] <= now:
            keys.type("i", now)
            presses.pop(0)
        assert keys.at(now) == (1.5, 0, 0), now
        now += 0.02
    assert keys.at(last + REPEAT_HOLD + 0.02) == ZERO_TWIST
    assert keys.at(last + 1.0) is None


def test_another_key_replaces_the_motion_immediately(keys: Keys) -> None:
    keys.type("ii", 0.0)
    keys.type("l", 0.1)
    assert keys.at(0.1) == (0, 0, -2)
    assert keys.at(0.1 + FIRST_HOLD) == (0, 0, -2)


def test_space_stops_and_keeps_the_robot(keys: Keys) -> None:
    keys.type("i", 0.0)
    keys.type(" ", 0.1)
    assert keys.at(0.1) == ZERO_TWIST
    assert keys.at(60.0) == ZERO_TWIST
    keys.type("i", 61.0)
    assert keys.at(61.0) == (1.5, 0, 0)


def test_nothing_is_commanded_before_the_first_key(keys: Keys) -> None:
    assert keys.at(0.0) is None


def test_speed_goes_in_steps_within_bounds(keys: Keys) -> None:
    keys.type("5", 0.0)
    assert keys.keyboard.share == 0.5
    keys.type("i", 0.0)
    assert keys.at(0.0) == (0.75, 0, 0)
    keys.type("+", 0.0)
    assert keys.keyboard.share == pytest.approx(0.55)
    keys.type("+" * 50, 0.0)
    assert keys.keyboard.share == 1.0
    keys.type("-" * 90, 0.0)
    assert keys.keyboard.share == 0.05
    keys.type("0", 0.0)
    assert keys.keyboard.share == 1.0


def test_sideways_only_where_the_robot_can() -> None:
    keys = Keys(Limits(1.5, 2.0, False))
    keys.type("i", 0.0)
    keys.type("J", 0.1)
    assert keys.at(0.1) in (None, ZERO_TWIST)
    assert "sideways" in keys.keyboard.message


def test_services_have_keys(keys: Keys) -> None:
    requests = keys.type("xXrhf", 0.0)
    assert requests == [
        "safety_stop",
        "release_safety_stop",
        "reset_odometry",
        "home_steering",
        "reset_faults",
    ]


def test_parameter_sets_in_turn() -> None:
    typed = list("ppp")
    keyboard = Keyboard(LIMITS, lambda: [typed.pop()] if typed else [], 1.0, ["floor", "rail"])
    requests = [request for _ in range(3) for request in keyboard.poll(0.0)]
    assert [request.service for request in requests] == ["set_drive_parameters"] * 3
    assert [request.arguments["set"] for request in requests] == ["floor", "rail", ""]
    assert keyboard.message == "parameters: the ordinary values"


def test_a_safety_stop_ends_the_motion_also_after_its_release(keys: Keys) -> None:
    keys.type("i", 0.0)
    keys.type("xX", 0.1)
    assert keys.at(0.2) is None


@pytest.mark.parametrize("typed", ["q", "\x04", "\x03"])
def test_keys_that_quit_stop_the_robot(keys: Keys, typed: str) -> None:
    keys.type("i", 0.0)
    keys.type(typed, 0.1)
    assert keys.keyboard.finished
    assert keys.at(0.1) == ZERO_TWIST


def test_a_closed_terminal_ends_the_teleoperation() -> None:
    typed = [["i"]]

    def read() -> list[str]:
        if not typed:
            raise EOFError
        return typed.pop()

    keyboard = Keyboard(LIMITS, read)
    keyboard.poll(0.0)
    assert keyboard.twist(0.0) == (0.75, 0, 0)
    keyboard.poll(0.0)
    assert keyboard.finished
    assert keyboard.twist(0.0) == ZERO_TWIST


def test_unknown_keys_have_no_effect(keys: Keys) -> None:
    assert keys.type("\x1b[5~\x1b[200~zäé\x1b\x1b\x00\x1a\x1c", 0.0) == []
    assert keys.at(0.0) is None
    assert not keys.keyboard.finished
