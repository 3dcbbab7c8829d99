"""From a joystick or gamepad to twists, with a dead-man button; devices are python-evdev's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.tools.teleoperation.operator import FIRST_SHARE, Limits, Operator, Request

DEAD_ZONE = 0.1
"""Part of an axis about its middle that is taken for zero."""
GIVE_WAY = 0.1
"""s for which zero is asked after the button is let go; then the source falls silent."""
SEARCH_PERIOD = 1.0
"""s between two looks for a joystick that was unplugged."""
MOST_EVENTS = 500
"""That are taken in a cycle; what is more waits."""

HELP = """\
Joystick: hold the left shoulder button (or the trigger) and move the left stick; the
right one turns.  The right shoulder button (or the thumb's) drives at full speed.
East button: safety stop; start: its release."""

# linux/input-event-codes.h
EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
SYN_DROPPED = 3
ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ = range(6)
BTN_TRIGGER, BTN_THUMB, BTN_THUMB2, BTN_TOP, BTN_TOP2, BTN_PINKIE = range(0x120, 0x126)
BTN_SOUTH, BTN_EAST = 0x130, 0x131
BTN_TL, BTN_TR, BTN_SELECT, BTN_START = 0x136, 0x137, 0x13A, 0x13B


class Range(Protocol):
    """Of an axis; ``value`` where it is."""

    value: int
    min: int
    max: int


class Event(Protocol):
    type: int
    code: int
    value: int


class Device(Protocol):
    """What is used of ``evdev.InputDevice``."""

    name: str

    def capabilities(self) -> Mapping[int, Sequence[Any]]:
        """Codes by type; of axes with their ranges."""

    def read_one(self) -> Event | None:
        """The next event, if there is one.  Raises ``OSError`` where the device is gone."""

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Layout:
    """Codes of axes and buttons; -1: there is none.

    ``enable`` is the dead-man button, ``turbo`` one for full speed; ``stop``, ``release`` and
    ``reset`` ask for the safety stop, its release, and a reset of faults.
    """

    forward: int = ABS_Y
    sideways: int = ABS_X
    turn: int = ABS_RX
    enable: int = BTN_TL
    turbo: int = BTN_TR
    stop: int = BTN_EAST
    release: int = BTN_START
    reset: int = BTN_SELECT

    @staticmethod
    def of(device: Device) -> Layout | None:
        """What suits the device; ``None`` where it is no joystick.

        Gamepads: left stick to move, right one to turn, the shoulder buttons as in ROS's
        teleop_twist_joy.  Sticks with a trigger: the trigger enables, and they turn by their twist
        axis, or by leaning to the side where they have none.
        """
        axes, buttons = _axes(device), _buttons(device)
        if not {ABS_X, ABS_Y} <= axes.keys():
            return None
        if BTN_SOUTH in buttons:
            return Layout(turn=ABS_RX if ABS_RX in axes else ABS_Z)
        if BTN_TRIGGER not in buttons:
            return None
        stick = Layout(
            enable=BTN_TRIGGER, turbo=BTN_THUMB, stop=BTN_THUMB2, release=BTN_TOP, reset=BTN_TOP2
        )
        if ABS_RZ in axes:
            return replace(stick, turn=ABS_RZ)
        return replace(stick, turn=ABS_X, sideways=-1)

    def changed(self, text: str, codes: Mapping[str, int]) -> Layout:
        """With entries from ``enable=BTN_TOP2,turn=ABS_Z``; ``codes`` by their names.

        Raises ``ParameterError``.
        """
        known = [field.name for field in fields(Layout)]
        found: dict[str, int] = {}
        for part in filter(None, (part.strip() for part in text.split(","))):
            name, _, code = part.partition("=")
            if name not in known:
                raise ParameterError(f"`{name}` is none of {', '.join(known)}")
            kind = "ABS_" if name in known[:3] else "BTN_"
            if not code.startswith(kind) or not isinstance(codes.get(code), int):
                raise ParameterError(
                    f"`{code}` is no code such as {kind}{'RX' if kind == 'ABS_' else 'TL'}"
                )
            found[name] = codes[code]
        return replace(self, **found)


Search = Callable[[], tuple[Device, Layout] | None]
"""Gives the device with its layout, ``None`` where none is plugged in."""


class Joystick:
    """An operator with a joystick in the hand.

    ``search`` gives the device with its layout, ``None`` where it is not plugged in; it is asked
    again while it is not.  A device that goes away stops the robot, and one that comes back
    drives only after its button was pressed anew.
    """

    def __init__(
        self,
        limits: Limits,
        search: Search,
        share: float = FIRST_SHARE,
    ) -> None:
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
        self._searched = float("-inf")
        self._drove = float("-inf")

    def poll(self, now: float) -> list[Request]:
        if self._device is None and not self._find(now):
            return []
        requests: list[Request] = []
        try:
            for _ in range(MOST_EVENTS):
                event = self._device.read_one() if self._device is not None else None
                if event is None:
                    break
                self._take(event, requests)
        except OSError:
            self._lose()
        return requests

    def twist(self, now: float) -> Twist | None:
        layout = self._layout
        turbo = self._pressed.get(layout.turbo, False)
        if turbo or self._pressed.get(layout.enable, False):
            self._drove = now
            x, y, yaw = (
                -self._axes.get(code, 0.0)
                for code in (layout.forward, layout.sideways, layout.turn)
            )
            return self.limits.twist(x, y, yaw, 1.0 if turbo else self.share)
        return ZERO_TWIST if now - self._drove <= GIVE_WAY else None

    def close(self) -> None:
        if self._device is not None:
            self._device.close()
            self._device = None
        self._forget()

    # -- inside --------------------------------------------------------------------------------

    def _find(self, now: float) -> bool:
        if now - self._searched < SEARCH_PERIOD:
            return False
        self._searched = now
        found = self._search()
        if found is None:
            self.message = self.message or "no joystick"
            return False
        self._device, self._layout = found
        self._ranges = {code: (axis.min, axis.max) for code, axis in _axes(self._device).items()}
        self.message = ""
        return True

    def _take(self, event: Event, requests: list[Request]) -> None:
        if event.type == EV_ABS and event.code in self._ranges:
            self._axes[event.code] = _part(event.value, *self._ranges[event.code])
        elif event.type == EV_KEY:
            before = self._pressed.get(event.code, False)
            self._pressed[event.code] = bool(event.value)
            if event.value and not before:
                self._ask(event.code, requests)
        elif event.type == EV_SYN and event.code == SYN_DROPPED:
            # Events were lost, the button's release perhaps.
            self._forget()

    def _ask(self, button: int, requests: list[Request]) -> None:
        layout = self._layout
        if button == layout.stop:
            requests.append(Request("safety_stop", {}))
        elif button == layout.release:
            requests.append(Request("release_safety_stop", {}))
        elif button == layout.reset:
            requests.append(Request("reset_faults", {}))

    def _forget(self) -> None:
        """Axes in the middle, no button pressed: what is held counts when it is pressed anew."""
        self._axes.clear()
        self._pressed.clear()

    def _lose(self) -> None:
        self.close()
        self.message = "the joystick is unplugged"


class OperatorPair:
    """Two operators at once: where the first asks for nothing, the second drives."""

    def __init__(self, first: Operator, second: Operator) -> None:
        self.finished = False
        self._both = (first, second)

    @property
    def share(self) -> float:
        return self._both[0].share

    @share.setter
    def share(self, share: float) -> None:
        for one in self._both:
            one.share = share

    @property
    def message(self) -> str:
        return self._both[1].message or self._both[0].message

    def poll(self, now: float) -> list[Request]:
        requests = [request for one in self._both for request in one.poll(now)]
        self.finished = any(one.finished for one in self._both)
        self._both[1].share = self._both[0].share
        return requests

    def twist(self, now: float) -> Twist | None:
        first, second = (one.twist(now) for one in self._both)
        return first if first is not None else second

    def close(self) -> None:
        for one in self._both:
            one.close()


def evdev_search(path: str, mapping: str) -> Search:
    """Looks for the device at ``path``, or the first joystick, by python-evdev.

    Raises ``ParameterError`` for a mapping that there cannot be, ``ImportError`` without evdev.
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


def _part(value: float, least: float, most: float) -> float:
    """-1..1 of an axis's range, 0 in the dead zone and growing from its edge."""
    if most <= least:
        return 0.0
    part = min(max(2.0 * (value - least) / (most - least) - 1.0, -1.0), 1.0)
    beyond = (abs(part) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return 0.0 if beyond <= 0.0 else beyond if part > 0.0 else -beyond
