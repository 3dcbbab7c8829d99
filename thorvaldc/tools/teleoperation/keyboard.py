"""Drives a robot from a terminal: the keys of a keyboard as twists, and a joystick beside them.

A terminal reports when a key is pressed and repeated, but not when the key is released. Pressing a
key therefore moves the robot for ``FIRST_HOLD`` s, and each repeat of the key moves the robot for
``REPEAT_HOLD`` s. After the last key repeat, the keyboard operator commands a zero twist for
``GIVE_WAY`` s and then no twist::

    key events  press            repeat repeat repeat
    time        |----- 0.25 to 0.66 s --|-|-|
    twist       |<------- drives ------------->|0 0 0|  none
                                          0.3 s after the last repeat
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence

from thorvaldc.cli.terminal import Terminal
from thorvaldc.runtime import teleop_loop
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.teleop_loop import Limits, Request, Vehicle
from thorvaldc.tools.teleoperation import joystick

FIRST_HOLD = 0.7
"""Time in s for which the press of a key drives.

Keyboards begin to repeat a key after 0.25 to 0.66 s.
"""
REPEAT_HOLD = 0.3
"""Time in s for which the repeat of a key drives.

The repeats of a key are 0.03 to 0.05 s apart, and ssh may delay the repeats.
"""
GIVE_WAY = 0.1
"""Time in s for which the keyboard commands zero after the robot was driven.

After this time, the keyboard commands no twist, so another twist source can drive.
"""
STEP = 1.1
"""Factor by which the keys ``+`` and ``-`` change the speed."""

# For each movement key, the fractions of the top speeds: forward, to the left, and turning left.
MOTIONS: dict[str, tuple[float, float, float]] = {
    "i": (1, 0, 0),
    ",": (-1, 0, 0),
    "j": (0, 0, 1),
    "l": (0, 0, -1),
    "u": (1, 0, 1),
    "o": (1, 0, -1),
    "m": (-1, 0, -1),
    ".": (-1, 0, 1),
    "J": (0, 1, 0),
    "L": (0, -1, 0),
    "U": (1, 1, 0),
    "O": (1, -1, 0),
    "M": (-1, 1, 0),
    ">": (-1, -1, 0),
}
_ALIASES = {
    "w": "i", "s": ",", "a": "j", "d": "l", "A": "J", "D": "L", "I": "i", "<": ",", "W": "i",
    "S": ",", "up": "i", "down": ",", "left": "j", "right": "l",
    "shift-left": "J", "shift-right": "L", "shift-up": "i", "shift-down": ",",
}  # fmt: skip

HELP = """\
  u i o    forward, with a turn to the left or right    or w a s d, or arrows
  j   l    turn on the spot                             with Shift: sideways
  m , .    backward                                     space or k: stop
  + -      faster, slower      1..9 0   10..90, 100 % of the top speed
  g        arm: the robot may move; G disarms           r   reset odometry
  x        safety stop: all sources; X releases it, F also those of others
  h        home steering       f   reset faults         p   next parameter set
  q        quit
A key drives while it is held; the robot stops when it is not repeated."""

_SERVICES: dict[str, Request] = {
    "x": Request("safety_stop", {}),
    "X": Request("release_safety_stop", {}),
    "F": Request("release_safety_stop", {"force": True}),
    "g": Request("arm", {}),
    "G": Request("disarm", {}),
    "r": Request("reset_odometry", {}),
    "h": Request("home_steering", {}),
    "f": Request("reset_faults", {}),
}


class Keyboard:
    """An operator who drives a robot with a keyboard.

    - ``read``: function that returns the names of the keys since the last call, or raises
      ``EOFError`` if the terminal is closed. If the terminal is closed, teleoperation ends.
    - ``sets``: names of the parameter sets of the robot.
    """

    def __init__(
        self,
        limits: Limits,
        read: Callable[[], list[str]],
        share: float = teleop_loop.FIRST_SHARE,
        sets: Sequence[str] = (),
    ) -> None:
        self.limits = limits
        self.share = share
        self.message = ""
        self.finished = False
        self._sets = ("", *sets)
        self._set = 0
        self._read = read
        self._motion = ZERO_TWIST
        self._key = ""
        self._until = 0.0
        self._driving = False
        self._stopped = False

    def poll(self, now: float) -> list[Request]:
        try:
            keys = self._read()
        except EOFError:
            keys, self.finished = [], True
        requests: list[Request] = []
        for key in keys:
            self._press(_ALIASES.get(key, key), now, requests)
        return requests

    def twist(self, now: float) -> Twist | None:
        """Returns the twist that the pressed keys command.

        After the space key, the commanded twist is zero until a movement key is pressed.
        """
        if self.finished:
            return ZERO_TWIST if self._driving else None
        if self._stopped:
            return ZERO_TWIST
        if self._driving and now <= self._until:
            x, y, yaw = self._motion
            return self.limits.twist(x, y, yaw, self.share)
        if self._driving and now <= self._until + GIVE_WAY:
            return ZERO_TWIST
        self._driving = False
        return None

    def close(self) -> None:
        """Does nothing: the terminal belongs to the caller."""

    def _press(self, key: str, now: float, requests: list[Request]) -> None:
        if key in MOTIONS:
            self._move(key, now)
        elif key in (" ", "k", "K"):
            self._stopped, self._driving = True, False
            self.message = "stop"
        elif key in ("+", "="):
            self._set_share(self.share * STEP)
        elif key in ("-", "_"):
            self._set_share(self.share / STEP)
        elif key.isdigit():
            self._set_share(int(key) / 10 or 1.0)
        elif key in ("q", "Q", "ctrl-d", "ctrl-c"):
            self.finished = True
        elif key == "p":
            self._set = (self._set + 1) % len(self._sets)
            requests.append(Request("set_drive_parameters", {"set": self._sets[self._set]}))
            self.message = f"parameters: {self._sets[self._set] or 'the ordinary values'}"
        elif key in _SERVICES:
            if key == "x":
                self._driving = False
            requests.append(_SERVICES[key])

    def _move(self, key: str, now: float) -> None:
        motion = MOTIONS[key]
        if motion[1] and not self.limits.sideways:
            self.message = "this robot cannot move sideways"
            self._driving = False
            return
        # Pressing the same key within its hold time counts as a key repeat. Pressing a different
        # key counts as a new key press.
        repeats = self._driving and key == self._key and now <= self._until
        self._until = now + (REPEAT_HOLD if repeats else FIRST_HOLD)
        self._motion, self._key = Twist(*motion), key
        self._driving, self._stopped = True, False
        self.message = ""

    def _set_share(self, share: float) -> None:
        self.share = min(max(share, teleop_loop.SMALLEST_SHARE), 1.0)
        self.message = ""


def drive_from_console(
    vehicle: Vehicle,
    source: str,
    share: float,
    search: joystick.Search | None,
    end_requested: Callable[[], bool],
) -> None:
    """Drives the robot until the operator quits or ``end_requested`` returns true.

    Raises ``ConnectionError`` if the process of the base driver ends.

    - ``source``: name of the twist source of the operator.
    - ``share``: initial share of the top speed, 0 to 1.
    - ``search``: function that finds the joystick, or ``None`` if the operator drives only with the
      keyboard.
    """
    description = vehicle.call("description")
    limits = Limits.of(description)
    keys = sys.stdin if sys.stdin.isatty() else None
    print(f"{description['robot']}, as {source}")
    help_texts = [HELP] * (keys is not None) + [joystick.HELP] * (search is not None)
    print(*help_texts, "", sep="\n", flush=True)
    # A pause for Python's garbage collection would delay the control cycle. ``gc.freeze`` shortens
    # the pauses for garbage collection, because frozen objects are not examined again.
    gc.collect()
    gc.freeze()
    with Terminal(keys, sys.stdout) as terminal:
        operator: teleop_loop.Operator = Keyboard(
            limits, terminal.read, share, description["parameter_sets"]
        )
        if search is not None:
            operator = joystick.OperatorPair(operator, joystick.Joystick(limits, search, share))
        try:
            teleop_loop.operate(vehicle, operator, source, terminal.show, end_requested)
        finally:
            operator.close()
