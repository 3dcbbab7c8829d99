"""A joystick drives while its button is held and stops the robot when unplugged.

The devices are simulated.
"""

from __future__ import annotations

import errno
import sys
import types
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pytest

from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.teleop_loop import Limits
from thorvaldc.tools.teleoperation import joystick as js
from thorvaldc.tools.teleoperation import keyboard
from thorvaldc.tools.teleoperation.joystick import Joystick, Layout, OperatorPair
from thorvaldc.tools.teleoperation.keyboard import Keyboard

LIMITS = Limits(1.5, 2.0, True)
CODES = {"ABS_Z": js.ABS_Z, "ABS_RX": js.ABS_RX, "BTN_TOP2": js.BTN_TOP2, "KEY_A": 30}


def test_codes_are_those_of_linux() -> None:
    """The numbers of linux/input-event-codes.h."""
    codes = {
        "EV_SYN": 0x00,
        "EV_KEY": 0x01,
        "EV_ABS": 0x03,
        "SYN_DROPPED": 3,
        "ABS_X": 0x00,
        "ABS_Y": 0x01,
        "ABS_Z": 0x02,
        "ABS_RX": 0x03,
        "ABS_RY": 0x04,
        "ABS_RZ": 0x05,
        "BTN_TRIGGER": 0x120,
        "BTN_THUMB": 0x121,
        "BTN_THUMB2": 0x122,
        "BTN_TOP": 0x123,
        "BTN_TOP2": 0x124,
        "BTN_PINKIE": 0x125,
        "BTN_SOUTH": 0x130,
        "BTN_EAST": 0x131,
        "BTN_NORTH": 0x133,
        "BTN_TL": 0x136,
        "BTN_TR": 0x137,
        "BTN_SELECT": 0x13A,
        "BTN_START": 0x13B,
    }
    assert {name: getattr(js, name) for name in codes} == codes


class Event(NamedTuple):
    type: int
    code: int
    value: int


class Axis(NamedTuple):
    value: int = 0
    min: int = -32768
    max: int = 32767


class Device:
    """A gamepad, or a device with other ``axes`` and ``buttons``."""

    name = "pad"

    def __init__(
        self,
        axes: Sequence[int] = (js.ABS_X, js.ABS_Y, js.ABS_Z, js.ABS_RX),
        buttons: Sequence[int] = (js.BTN_SOUTH, js.BTN_EAST, js.BTN_TL, js.BTN_TR),
    ) -> None:
        self._capabilities = {
            js.EV_ABS: [(code, Axis()) for code in axes],
            js.EV_KEY: list(buttons),
        }
        self.events: deque[Event] = deque()
        self.unplugged = False
        self.closed = False

    def capabilities(self) -> Mapping[int, Sequence[Any]]:
        return self._capabilities

    def read_one(self) -> Event | None:
        if self.unplugged:
            raise OSError(errno.ENODEV, "No such device")
        return self.events.popleft() if self.events else None

    def close(self) -> None:
        self.closed = True

    def axis(self, code: int, value: int) -> None:
        self.events.append(Event(js.EV_ABS, code, value))

    def button(self, code: int, value: int = 1) -> None:
        self.events.append(Event(js.EV_KEY, code, value))


class Hand:
    def __init__(self, device: Device | None = None, share: float = 0.5) -> None:
        self.device: Device | None = device or Device()
        self.joystick = Joystick(LIMITS, self.search, share)

    def search(self) -> tuple[Device, Layout] | None:
        if self.device is None:
            return None
        layout = Layout.of(self.device)
        assert layout is not None
        return self.device, layout

    def at(self, now: float) -> Twist | None:
        self.joystick.poll(now)
        return self.joystick.twist(now)

    @property
    def pad(self) -> Device:
        assert self.device is not None
        return self.device


@pytest.fixture
def hand() -> Hand:
    hand = Hand()
    hand.at(0.0)
    return hand


def test_sticks_alone_do_nothing(hand: Hand) -> None:
    hand.pad.axis(js.ABS_Y, -32768)
    assert hand.at(0.1) is None


def test_sticks_drive_while_the_button_is_held(hand: Hand) -> None:
    hand.pad.button(js.BTN_TL)
    hand.pad.axis(js.ABS_Y, -32768)
    assert hand.at(0.1) == (0.75, 0, 0)
    hand.pad.axis(js.ABS_Y, 32767)
    hand.pad.axis(js.ABS_RX, -32768)
    assert hand.at(0.2) == (-0.75, 0, 1.0)
    hand.pad.axis(js.ABS_X, 32767)
    result = hand.at(0.3)
    assert result is not None
    assert result.vy == pytest.approx(-0.75)
    hand.pad.button(js.BTN_TL, 0)
    assert hand.at(0.32) == ZERO_TWIST
    assert hand.at(0.5) is None  # others may drive


def test_a_button_for_full_speed(hand: Hand) -> None:
    hand.pad.button(js.BTN_TR)
    hand.pad.axis(js.ABS_Y, -32768)
    assert hand.at(0.1) == (1.5, 0, 0)


def test_the_speed_is_continuous_at_the_edge_of_the_dead_zone(hand: Hand) -> None:
    hand.pad.button(js.BTN_TR)
    hand.pad.axis(js.ABS_Y, -3000)
    assert hand.at(0.1) == ZERO_TWIST
    hand.pad.axis(js.ABS_Y, -3600)
    result = hand.at(0.2)
    assert result is not None
    assert 0.0 < result.vx < 0.03
    hand.pad.axis(js.ABS_Y, -18022)  # 55 %
    assert hand.at(0.3) == pytest.approx((0.75, 0, 0), abs=1e-3)


def test_unplugging_stops_until_the_button_is_pressed_again(hand: Hand) -> None:
    hand.pad.button(js.BTN_TL)
    hand.pad.axis(js.ABS_Y, -32768)
    assert hand.at(1.0) == (0.75, 0, 0)
    gone = hand.pad
    gone.unplugged, hand.device = True, None
    assert hand.at(1.02) == ZERO_TWIST
    assert gone.closed
    assert hand.joystick.message == "the joystick is unplugged"
    assert hand.at(1.5) is None
    hand.device = Device()
    hand.device.axis(js.ABS_Y, -32768)  # the stick is still held
    assert hand.at(2.6) is None
    assert hand.joystick.message == ""
    hand.pad.button(js.BTN_TL)
    assert hand.at(2.7) == (0.75, 0, 0)


def test_a_joystick_plugged_in_later_is_found() -> None:
    hand = Hand()
    pad, hand.device = hand.device, None
    assert hand.at(0.0) is None
    assert hand.joystick.message == "no joystick"
    hand.device = pad
    hand.pad.button(js.BTN_TL)
    assert hand.at(0.5) is None  # it looks once in a second
    assert hand.at(1.0) == ZERO_TWIST


def test_lost_events_release_the_button(hand: Hand) -> None:
    hand.pad.button(js.BTN_TL)
    hand.pad.axis(js.ABS_Y, -32768)
    assert hand.at(0.1) == (0.75, 0, 0)
    hand.pad.events.append(Event(js.EV_SYN, js.SYN_DROPPED, 0))
    assert hand.at(0.2) == ZERO_TWIST


def test_buttons_request_services(hand: Hand) -> None:
    for button in (js.BTN_EAST, js.BTN_START, js.BTN_SELECT):
        hand.pad.button(button)
        hand.pad.button(button, 2)  # held
        hand.pad.button(button, 0)
    requests = [request.service for request in hand.joystick.poll(0.1)]
    assert requests == ["safety_stop", "release_safety_stop", "reset_faults"]


def test_layouts_by_what_the_device_has() -> None:
    simple = Device((js.ABS_X, js.ABS_Y, js.ABS_Z))
    stick = Device((js.ABS_X, js.ABS_Y, js.ABS_RZ), (js.BTN_TRIGGER, js.BTN_THUMB))
    plain = Device((js.ABS_X, js.ABS_Y), (js.BTN_TRIGGER,))
    assert Layout.of(Device()) == Layout()
    assert Layout.of(simple) == Layout(turn=js.ABS_Z)
    result = Layout.of(stick)
    assert result is not None
    assert (result.enable, result.turn, result.sideways) == (js.BTN_TRIGGER, js.ABS_RZ, js.ABS_X)
    result = Layout.of(plain)
    assert result is not None
    assert (result.turn, result.sideways) == (js.ABS_X, -1)
    assert Layout.of(Device((), (30, 31))) is None  # a keyboard
    assert Layout.of(Device((js.ABS_X, js.ABS_Y), (0x14A,))) is None  # a touch pad


def test_a_layout_can_be_changed() -> None:
    result = Layout().changed("enable=BTN_TOP2, turn=ABS_Z", CODES)
    assert (result.enable, result.turn, result.forward) == (js.BTN_TOP2, js.ABS_Z, js.ABS_Y)
    for text, reason in {
        "go=BTN_TOP2": "`go` is none of forward, sideways",
        "enable": "`` is no code such as BTN_TL",
        "enable=ABS_Z": "`ABS_Z` is no code such as BTN_TL",
        "turn=ABS_NONE": "`ABS_NONE` is no code such as ABS_RX",
    }.items():
        with pytest.raises(ParameterError) as refused:
            Layout().changed(text, CODES)
        assert reason in str(refused.value)


def test_the_first_joystick_is_used_and_other_devices_are_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keys, pad = Device((), (30,)), Device()
    devices = {"/dev/input/event1": keys, "/dev/input/event2": pad}

    def open_device(path: str) -> Device:
        if path not in devices:
            raise PermissionError(path)
        return devices[path]

    evdev = types.ModuleType("evdev")
    evdev.list_devices = lambda: ["/dev/input/event2", *reversed(devices), "/dev/input/event0"]  # type: ignore[attr-defined]
    evdev.InputDevice = open_device  # type: ignore[attr-defined]
    evdev.ecodes = types.SimpleNamespace(ecodes=CODES)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "evdev", evdev)
    search = js.evdev_search("", "enable=BTN_TOP2")
    assert search() == (pad, Layout(enable=js.BTN_TOP2))
    assert keys.closed
    assert not pad.closed
    assert js.evdev_search("/dev/input/event0", "")() is None
    assert js.evdev_search("/dev/input/event1", "")() is None
    del devices["/dev/input/event2"]
    assert search() is None
    with pytest.raises(ParameterError):
        js.evdev_search("", "enable=nothing")


def test_the_keyboard_comes_first_beside_a_joystick(hand: Hand) -> None:
    typed: list[str] = []
    keyboard = Keyboard(LIMITS, lambda: [typed.pop(0)] if typed else [], 1.0)
    both = OperatorPair(keyboard, hand.joystick)
    hand.pad.button(js.BTN_TL)
    hand.pad.axis(js.ABS_Y, -32768)
    both.poll(0.1)
    assert both.twist(0.1) == (1.5, 0, 0)  # at the keyboard's share
    typed.append(" ")
    both.poll(0.2)
    assert both.twist(0.2) == ZERO_TWIST
    assert both.message == "stop"
    typed.append("q")
    both.poll(0.3)
    assert both.finished


def test_many_events_do_not_delay_the_cycle(hand: Hand) -> None:
    for value in range(10_000):
        hand.pad.axis(js.ABS_Y, value)
    hand.joystick.poll(0.1)
    assert len(hand.pad.events) == 10_000 - js.MOST_EVENTS


def test_the_help_fits_80_columns() -> None:
    assert max(map(len, f"{keyboard.HELP}\n{js.HELP}".splitlines())) < 80
