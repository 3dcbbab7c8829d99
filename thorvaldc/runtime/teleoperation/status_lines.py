"""The status lines that the operator sees in the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from thorvaldc.diagnostics.text_layout import paragraph
from thorvaldc.runtime.se2 import Twist

WIDTH = 79
INDENT = " " * 7


def status_lines(
    state: Mapping[str, Any], commanded: Twist | None, share: float, message: str
) -> list[str]:
    """Returns the status lines for the operator of a robot, of at most ``WIDTH`` columns.

    The lines are the commanded twist, the twist that the base driver applies with the limit that
    scales it, the pose of the robot, the state of the base driver, the fault, and a message.

    - ``state``: result of the service ``state``.
    - ``commanded``: twist that the operator commands, or ``None``.
    """
    command = _twist_text(commanded) if commanded is not None else "nothing"
    source = state.get("source") or "nobody"
    x, y, yaw = (state["pose"][name] for name in ("x", "y", "yaw"))
    in_force = _twist_text(Twist(**state["in_force"]))
    limit, not_followed = state.get("limited_by"), state.get("not_followed")
    parts = [str(state.get("supervisor") or state["mode"]), f"drives: {source}"]
    if state["locks"]:
        parts.append(f"locked: {', '.join(state['locks'])}")
    if not state["fault"] and state["held"] == "disarmed":
        parts.append("disarmed: press g")
    elif not state["fault"] and state["held"] and state["held"] != parts[0]:
        parts.append(f"held: {state['held']}")
    return [
        f"{share * 100:3.0f} %  commanded {command}",
        f"{INDENT}in force  {in_force}",
        *(_wrapped(f"limited by {limit}") if limit else []),
        *(_wrapped(not_followed) if not_followed and not limit else []),
        f"{INDENT}x {x:.2f} m  y {y:.2f} m  yaw {math.degrees(yaw):.1f} deg",
        *_wrapped("  ".join(parts)),
        *(_wrapped(f"FAULT {state['fault']}") if state["fault"] else []),
        *(_wrapped(message) if message else []),
    ]


def _wrapped(text: str) -> list[str]:
    return paragraph(text, WIDTH, INDENT)


def _twist_text(twist: Twist) -> str:
    # Adding 0.0 turns -0.0 into 0.0, which is shown without a minus sign.
    x, y, yaw = (round(value, 2) + 0.0 for value in twist)
    return f"{x:+.2f} {y:+.2f} m/s {yaw:+.2f} rad/s"
