"""The two status lines that the operator sees in the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from thorvaldc.runtime.se2 import Twist


def status_lines(
    state: Mapping[str, Any], commanded: Twist | None, share: float, message: str
) -> list[str]:
    """Returns the two status lines for the operator of a robot.

    The first status line shows the commanded twist and the twist that the base driver applies. The
    second status line shows the pose of the robot and the state of the base driver.

    - ``state``: result of the service ``state``.
    - ``commanded``: twist that the operator commands, or ``None``.
    """
    command = _twist_text(commanded) if commanded is not None else f"{'nothing':^24}"
    source = state.get("source") or "nobody"
    x, y, yaw = (state["pose"][name] for name in ("x", "y", "yaw"))
    pose = f"x {x:.2f} m  y {y:.2f} m  yaw {math.degrees(yaw):.1f} deg"
    parts = [str(state.get("supervisor") or state["mode"]), f"drives: {source}"]
    if state["locks"]:
        parts.append(f"locked: {', '.join(state['locks'])}")
    if state["fault"]:
        parts.append(f"FAULT {state['fault']}")
    elif state["held"] == "disarmed":
        parts.append("disarmed: press g")
    elif state["held"] and state["held"] != parts[0]:
        parts.append(f"held: {state['held']}")
    if message:
        parts.append(message)
    in_force = _twist_text(Twist(**state["in_force"]))
    first = f"{share * 100:3.0f} %  commanded {command}  in force {in_force}"
    return [first, f"{pose}  |  {'  '.join(parts)}"]


def _twist_text(twist: Twist) -> str:
    # Adding 0.0 turns -0.0 into 0.0, which is shown without a minus sign.
    x, y, yaw = (round(value, 2) + 0.0 for value in twist)
    return f"{x:+.2f} {y:+.2f} m/s {yaw:+.2f} rad/s"
