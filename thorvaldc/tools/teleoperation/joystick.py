"""Converts the input of a joystick or gamepad to twists, with a dead-man button.

The joystick is read with the package python-evdev (Linux).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.teleop_loop import FIRST_SHARE, Limits, Operator, Request

DEAD_ZONE = 0.1
"""Share of half an axis around its centre that counts as zero."""
GIVE_WAY = 0.1
"""Time in s for which the joystick commands zero after the dead-man button is released.

After this time, the joystick commands no twist, so another twist source can drive.
"""
SEARCH_PERIOD = 1.0
"""Time in s between two searches for an unplugged joystick."""
MOST_EVENTS = 500
"""Largest number of events that are read in a cycle. The next cycle reads the remaining events."""

HELP = """\
Joystick: hold the left shoulder button (or the trigger) and move the left
stick; the right one turns.  The right shoulder button (or the thumb's) drives
at full speed.
North button: arm.  East button: safety stop; start: its release."""

# Codes of linux/input-event-codes.h.
EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
SYN_DROPPED = 3
ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ = range(6)
BTN_TRIGGER, BTN_THUMB, BTN_THUMB2, BTN_TOP, BTN_TOP2, BTN_PINKIE = range(0x120, 0x126)
BTN_SOUTH, BTN_EAST, BTN_NORTH = 0x130, 0x131, 0x133
BTN_TL, BTN_TR, BTN_SELECT, BTN_START = 0x136, 0x137, 0x13A, 0x13B


class Range(Protocol):
    """The range and the current value of a joystick axis."""

    value: int
    min: int
    max: int


class Event(Protocol):
    """The attributes of ``evdev.InputEvent`` that this module uses."""

    type: int
    code: int
    value: int


class Device(Protocol):
    """The attributes and methods of ``evdev.InputDevice`` that this module uses."""

    name: str

    def capabilities(self) -> Mapping[int, Sequence[Any]]:
        """Returns the Linux event codes of all axes and buttons of a device, by event type.

        Each axis of the device is a pair of its event code and its range.
        """

    def read_one(self) -> Event | None:
        """Returns the next event of the joystick, or ``None`` if no event is waiting.

        Raises ``OSError`` if the joystick is unplugged.
        """

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Layout:
    """The Linux event codes of the axes and buttons of a joystick.

    The code -1 means that an axis or a button is not used.

    - ``enable``: dead-man button, which must be pressed while the robot drives.
    - ``turbo``: dead-man button for the top speed.
    - ``stop``: button that requests the safety stop.
    - ``release``: button that requests the release of the safety stop.
    - ``reset``: button that requests a reset of faults.
    - ``arm``: button that requests to arm the robot.
    """

    forward: int = ABS_Y
    sideways: int = ABS_X
    turn: int = ABS_RX
    enable: int = BTN_TL
    turbo: int = BTN_TR
    stop: int = BTN_EAST
    release: int = BTN_START
    reset: int = BTN_SELECT
    arm: int = BTN_NORTH

    @staticmethod
    def of(device: Device) -> Layout | None:
        """Returns the axes and buttons to use for a device, or ``None`` if the device is no
        joystick.

        The left stick of a gamepad moves the robot, and the right stick turns the robot. The
        shoulder buttons of a gamepad have the same functions as in ROS's teleop_twist_joy. The
        trigger button of a joystick is the dead-man button. The twist axis of a joystick turns the
        robot. If the joystick has no twist axis, the sideways axis turns the robot.
        """
        axes, buttons = _axes(device), _buttons(device)
        if not {ABS_X, ABS_Y} <= axes.keys():
            return None
        if BTN_SOUTH in buttons:
            return Layout(turn=ABS_RX if ABS_RX in axes else ABS_Z)
        if BTN_TRIGGER not in buttons:
            return None
        stick = Layout(
            enable=BTN_TRIGGER,
            turbo=BTN_THUMB,
            stop=BTN_THUMB2,
            release=BTN_TOP,
            reset=BTN_TOP2,
            arm=BTN_PINKIE,
        )
        if ABS_RZ in axes:
            return replace(stick, turn=ABS_RZ)
        return replace(stick, turn=ABS_X, sideways=-1)

    def changed(self, text: str, codes: Mapping[str, int]) -> Layout:
        """Returns the joystick layout with the changed axes and buttons of a text such as
        ``enable=BTN_TOP2,turn=ABS_Z``.

        ``codes`` maps the names of Linux event codes to numbers. Raises ``ParameterError`` if
        ``text`` contains an unknown axis or button name.
        """
        names = [field.name for field in fields(Layout)]
        entries: dict[str, int] = {}
        for part in filter(None, (part.strip() for part in text.split(","))):
            name, _, code = part.partition("=")
            if name not in names:
                raise ParameterError(f"`{name}` is none of {', '.join(names)}")
            kind = "ABS_" if name in names[:3] else "BTN_"
            if not code.startswith(kind) or not isinstance(codes.get(code), int):
                raise ParameterError(
                    f"`{code}` is no code such as {kind}{'RX' if kind == 'ABS_' else 'TL'}"
                )
            entries[name] = codes[code]
        return replace(self, **entries)


Search = Callable[[], tuple[Device, Layout] | None]
"""A search returns the device and its layout, or ``None`` if no joystick is plugged in."""


class Joystick:
    """An operator who drives a robot with a joystick.

    While no joystick is plugged in, the operator calls the function ``search`` repeatedly. The
    robot stops when the joystick is unplugged. When the joystick is plugged in again, the operator
    must press the dead-man button again to drive.
    """

    def __init__(self, limits: Limits, search: Search, share: float = FIRST_SHARE) -> None:
        self.limits = limits
        self.share = share
        self.message = ""
        self.finished = False
        self._search = search
        self._device: Device | None = None
        self._layout = Layout()
        self._ranges: dict[int, tuple[float, float]] = {}
        self._axes: dict[int, float] = {}
        self._pressed: dict[int, bool] = {}
        self._last_search = float("-inf")
        self._last_drive = float("-inf")

    def poll(self, now: float) -> list[Request]:
        if self._device is None and not self._search_again(now):
            return []
        requests: list[Request] = []
        try:
            for _ in range(MOST_EVENTS):
                event = self._device.read_one() if self._device is not None else None
                if event is None:
                    break
                self._handle(event, requests)
        except OSError:
            self._unplug()
        return requests

    def twist(self, now: float) -> Twist | None:
        layout = self._layout
        turbo = self._pressed.get(layout.turbo, False)
        if turbo or self._pressed.get(layout.enable, False):
            self._last_drive = now
            x, y, yaw = (
                -self._axes.get(code, 0.0)
                for code in (layout.forward, layout.sideways, layout.turn)
            )
            return self.limits.twist(x, y, yaw, 1.0 if turbo else self.share)
        return ZERO_TWIST if now - self._last_drive <= GIVE_WAY else None

    def close(self) -> None:
        if self._device is not None:
            self._device.close()
            self._device = None
        self._release_all()

    def _search_again(self, now: float) -> bool:
        if now - self._last_search < SEARCH_PERIOD:
            return False
        self._last_search = now
        device_and_layout = self._search()
        if device_and_layout is None:
            self.message = self.message or "no joystick"
            return False
        self._device, self._layout = device_and_layout
        self._ranges = {code: (axis.min, axis.max) for code, axis in _axes(self._device).items()}
        self.message = ""
        return True

    def _handle(self, event: Event, requests: list[Request]) -> None:
        if event.type == EV_ABS and event.code in self._ranges:
            self._axes[event.code] = _scaled(event.value, *self._ranges[event.code])
        elif event.type == EV_KEY:
            was_pressed = self._pressed.get(event.code, False)
            self._pressed[event.code] = bool(event.value)
            layout = self._layout
            services = {
                layout.arm: "arm",
                layout.reset: "reset_faults",
                layout.release: "release_safety_stop",
                layout.stop: "safety_stop",  # also if another function has the same button
            }
            if event.value and not was_pressed and event.code in services:
                requests.append(Request(services[event.code], {}))
        elif event.type == EV_SYN and event.code == SYN_DROPPED:
            # The event SYN_DROPPED means that the kernel has dropped joystick events. The release
            # of the dead-man button may be one of the dropped events.
            self._release_all()

    def _release_all(self) -> None:
        """Sets all axes of the joystick to zero and all buttons to released.

        A joystick button that is still held counts only after it is pressed again.
        """
        self._axes.clear()
        self._pressed.clear()

    def _unplug(self) -> None:
        self.close()
        self.message = "the joystick is unplugged"


class OperatorPair:
    """A pair of operators who drive the same robot.

    The second operator drives while the first operator commands no twist.
    """

    def __init__(self, first: Operator, second: Operator) -> None:
        self.finished = False
        self.share = first.share
        self._operators = (first, second)

    @property
    def message(self) -> str:
        return self._operators[1].message or self._operators[0].message

    def poll(self, now: float) -> list[Request]:
        requests = [request for operator in self._operators for request in operator.poll(now)]
        self.finished = any(operator.finished for operator in self._operators)
        self.share = self._operators[1].share = self._operators[0].share
        return requests

    def twist(self, now: float) -> Twist | None:
        first, second = (operator.twist(now) for operator in self._operators)
        return first if first is not None else second

    def close(self) -> None:
        for operator in self._operators:
            operator.close()


def evdev_search(path: str, mapping: str) -> Search:
    """Returns a function that searches for the joystick at the device path ``path``.

    If ``path`` is empty, the first joystick is used. Raises ``ParameterError`` if the mapping of
    joystick axes and buttons is invalid. Raises ``ImportError`` if evdev is not installed.
    """
    import evdev

    codes = {name: code for name, code in evdev.ecodes.ecodes.items() if isinstance(code, int)}
    Layout().changed(mapping, codes)

    def search() -> tuple[Device, Layout] | None:
        for candidate in [path] if path else sorted(evdev.list_devices()):
            try:
                device = evdev.InputDevice(candidate)
            except OSError:
                continue
            layout = Layout.of(device)
            if layout is None and path and mapping:
                layout = Layout()
            if layout is not None:
                return device, layout.changed(mapping, codes)
            device.close()
        return None

    return search


def _axes(device: Device) -> dict[int, Range]:
    return dict(device.capabilities().get(EV_ABS, ()))


def _buttons(device: Device) -> list[int]:
    return list(device.capabilities().get(EV_KEY, ()))


def _scaled(value: float, least: float, most: float) -> float:
    """Returns the value of a joystick axis, scaled to the range -1 to 1.

    The scaled value of the axis is zero in the dead zone and continuous at the edge of the dead
    zone.
    """
    if most <= least:
        return 0.0
    share = min(max(2.0 * (value - least) / (most - least) - 1.0, -1.0), 1.0)
    magnitude = max((abs(share) - DEAD_ZONE) / (1.0 - DEAD_ZONE), 0.0)
    return math.copysign(magnitude, share) if magnitude else 0.0
