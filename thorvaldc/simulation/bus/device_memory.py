"""Stores the non-volatile memory of simulated devices in a JSON file between two runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

Memory = dict[str, dict[str, Any]]
"""Stored values by device name and key."""


def read_memory(path: Path) -> Memory:
    """Returns the stored values of the simulated devices.

    If the file does not exist, the function returns an empty mapping.  Raises ``ValueError`` if the
    content of the file is invalid.
    """
    if not path.exists():
        return {}
    try:
        memory = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:  # no UTF-8 text, or no JSON
        raise ValueError(f"{path}: {error}") from None
    if not (isinstance(memory, dict) and all(_is_device(values) for values in memory.values())):
        raise ValueError(f"{path} is not the memory of simulated devices")
    return memory


def _is_device(values: Any) -> bool:
    return isinstance(values, dict) and all(
        isinstance(value, int)
        or (isinstance(value, dict) and all(isinstance(entry, int) for entry in value.values()))
        for value in values.values()
    )


def write_memory(path: Path, simulated: SimulatedRobot) -> None:
    """Writes the non-volatile memory of all simulated devices to the JSON file."""
    memory = {name: device.nonvolatile for name, device in simulated.devices.items()}
    path.write_text(json.dumps(memory, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
