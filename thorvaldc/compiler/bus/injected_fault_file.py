"""Reads a file with faults that a simulation injects on the CAN buses of a robot."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.compiler.bus.injected_faults import read_bus_faults
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.bus_faults import BusFaults


def read_faults(path: Path | str, robot: Robot, report: Report) -> BusFaults | None:
    """Reads the injected faults from a file.

    Returns ``None`` and reports the errors if the file is not valid.
    """
    shape, content = Report(), Report()
    document = read_file(Path(path), str(path), shape)
    if document is None:
        report.extend(shape)
        return None
    check(document, "bus_faults", shape)
    script = read_bus_faults(without_invalid_values(document, shape), robot, content)
    report.extend(shape)
    report.extend(content.excluding_spans_of(shape))
    return None if shape.has_errors or content.has_errors else script
