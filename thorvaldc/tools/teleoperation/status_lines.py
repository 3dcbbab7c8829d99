"""The lines that an operator sees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from thorvaldc.runtime.se2 import Twist


def status_lines(
    state: Mapping[str, Any], wanted: Twist | None, share: float, message: str
) -> list[str]:
    """Two lines: what is asked for and in force, and where the robot is and how it does.

    ``state`` is that of the ``state`` service, ``wanted`` what the operator asks for.
    """
    asked = _twist(wanted) if wanted is not None else f"{'nothing':^24}"
    drives = state.get("source") or "nobody"
    pose = state["pose"]
    place = f"x {pose['x']:.2f} m  y {pose['y']:.2f} m  yaw {math.degrees(pose['yaw']):.1f} deg"
    parts = [str(state.get("supervisor") or state["mode"]), f"drives: {drives}"]
    if state["locks"]:
        parts.append(f"locked: {', '.join(state['locks'])}")
    if state["fault"]:
        parts.append(f"FAULT {state['fault']}")
    elif state["held"] and state["held"] != parts[0]:
        parts.append(f"held: {state['held']}")
    if message:
        parts.append(message)
    first = f"{share * 100:3.0f} %  asked {asked}  in force {_twist(Twist(**state['in_force']))}"
    return [first, f"{place}  |  {'  '.join(parts)}"]


def _twist(twist: Twist) -> str:
    # Adding zero makes zero of minus zero.
    x, y, yaw = (round(value, 2) + 0.0 for value in twist)
    return f"{x:+.2f} {y:+.2f} m/s {yaw:+.2f} rad/s"
