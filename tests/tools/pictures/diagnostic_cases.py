"""Runs the cases of tests/diagnostics that read record.csv, with the command-line ``options``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.tools.pictures.replay import read_replay_record


def _read(case: dict[str, Any], entry: str) -> Report:
    compilation = compile_file(entry)
    assert isinstance(compilation.model, Robot)
    robots = [(compilation.model.name, compilation.model)]
    read_replay_record(Path("record.csv"), robots, compilation.report, for_plot="options" in case)
    return compilation.report


COMMANDS = {"replay": _read}
