"""Teleoperation of a robot from a terminal, with a keyboard and a joystick."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable

from thorvaldc.cli.terminal import Terminal
from thorvaldc.runtime.teleop_loop import Limits, Operator, Vehicle, operate
from thorvaldc.tools.teleoperation.joystick import HELP as JOYSTICK_HELP
from thorvaldc.tools.teleoperation.joystick import Joystick, OperatorPair, Search
from thorvaldc.tools.teleoperation.keyboard import HELP as KEYBOARD_HELP
from thorvaldc.tools.teleoperation.keyboard import Keyboard


def drive_from_console(
    vehicle: Vehicle,
    source: str,
    share: float,
    search: Search | None,
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
    help_texts = [KEYBOARD_HELP] * (keys is not None) + [JOYSTICK_HELP] * (search is not None)
    print(*help_texts, "", sep="\n", flush=True)
    # A pause for Python's garbage collection would delay the control cycle. ``gc.freeze`` shortens
    # the pauses for garbage collection, because frozen objects are not examined again.
    gc.collect()
    gc.freeze()
    with Terminal(keys, sys.stdout) as terminal:
        operator: Operator = Keyboard(limits, terminal.read, share, description["parameter_sets"])
        if search is not None:
            operator = OperatorPair(operator, Joystick(limits, search, share))
        try:
            operate(vehicle, operator, source, terminal.show, end_requested)
        finally:
            operator.close()
