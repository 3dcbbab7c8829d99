"""Stores the non-volatile memory of simulated devices in a JSON file between two runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.atomic_file import write_file
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

Memory = dict[str, dict[str, Any]]
"""Stored values by device name and key."""


def read_memory(path: Path, report: Report) -> Memory | None:
    """Returns the stored values of the simulated devices.

    If the file does not exist, the function returns an empty mapping.  Returns ``None`` and reports
    errors if the content of the file is invalid.
    """
    if not path.exists():
        return {}
    document = read_file(path, str(path), report)
    if document is None or not check(document, "device_memory", report):
        return None
    memory: Memory = document.plain()
    return memory


def write_memory(path: Path, simulated: SimulatedRobot) -> None:
    """Writes the non-volatile memory of all simulated devices to the JSON file."""
    memory = {name: device.nonvolatile for name, device in simulated.devices.items()}
    write_file(path, json.dumps(memory, indent=1, ensure_ascii=False) + "\n")
