"""Reads a file of faults to inject on a robot's simulated bus."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.compiler.bus.injected_faults import read_bus_faults
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.bus_faults import BusFaults


def read_faults(path: Path | str, robot: Robot, report: Report) -> BusFaults | None:
    """Returns the injected faults of a file; ``None`` if the file has errors (reported)."""
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
