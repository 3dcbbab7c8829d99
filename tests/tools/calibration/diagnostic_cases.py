"""Runs the cases of tests/diagnostics that calibrate, with the measured ``distance``."""

from __future__ import annotations

from typing import Any

from tests.recording import logged
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.tools.calibration.self_calibration import calibrate


def _calibrate(case: dict[str, Any], entry: str) -> Report:
    compilation = compile_file(entry)
    assert isinstance(compilation.model, Robot)
    log = logged(compilation.model, case, compilation.report)
    if log is not None:
        calibrate(compilation.model, log, compilation.report, case.get("distance"), "joints.csv")
    return compilation.report


COMMANDS = {"calibrate": _calibrate}
