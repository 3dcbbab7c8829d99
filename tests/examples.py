"""Compiled examples; each is compiled once per test run."""

from __future__ import annotations

import functools
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot

FOLDER = Path(__file__).parent.parent / "examples"
ROBOTS = tuple(sorted(path.parent.name for path in FOLDER.glob("*/robot.yaml")))
FLEETS = tuple(sorted(path.parent.name for path in FOLDER.glob("*/fleet.yaml")))


@functools.cache
def example_robot(name: str) -> Robot:
    compilation = compile_file(FOLDER / name / "robot.yaml")
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


@functools.cache
def example_fleet(name: str) -> Fleet:
    compilation = compile_file(FOLDER / name / "fleet.yaml")
    assert isinstance(compilation.model, Fleet), [d.message for d in compilation.report]
    return compilation.model
