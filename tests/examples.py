"""The examples, compiled once per test run."""

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
    done = compile_file(FOLDER / name / "robot.yaml")
    assert isinstance(done.model, Robot), [d.message for d in done.report]
    return done.model


@functools.cache
def example_fleet(name: str) -> Fleet:
    done = compile_file(FOLDER / name / "fleet.yaml")
    assert isinstance(done.model, Fleet), [d.message for d in done.report]
    return done.model
