"""The warning that a command prints before it drives a real robot."""

from __future__ import annotations

import os
from pathlib import Path

from thorvaldc.cli.diagnostic_output import message
from thorvaldc.runtime.run_session import UNTESTED

SIMULATED = ("virtual", "sim", "udp")
"""Kinds of CAN interfaces that are not connected to hardware."""


def is_hardware(interface: str) -> bool:
    """Returns whether a CAN interface such as ``socketcan:can0`` can be connected to hardware."""
    return interface.partition(":")[0] not in SIMULATED


def warn_once() -> None:
    """Prints the warning about untested hardware, but only once for each user."""
    folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    mark = folder / "thorvaldc" / "untried-told"
    if mark.exists():
        return
    message(f"note: {UNTESTED}")
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.write_text("The note on untried hardware was shown.\n", encoding="utf-8")
    except OSError:
        return  # the next run shows it again
