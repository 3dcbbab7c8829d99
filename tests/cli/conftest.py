"""Runs the command in this process."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from thorvaldc.cli.main import run_command
from thorvaldc.tool_folders import tools

GOOD = """\
thorvaldc: 1
name: good
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: 1}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 2}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, can: 3}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, can: 4}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}, can: 1}
"""
SLOW = "driver: {rate: 5 Hz, command_timeout: 2 s}\n"
"""For runs in real time: with a slow control cycle, a busy computer is no drive that is silent."""
UNPOWERED = GOOD[: GOOD.index("  battery:")]
"""The robot on a cable: its mass is symmetrical."""
# Two errors.
BAD = GOOD.replace("name: good", "name: Bad").replace("can: 2", "cam: 2")
# A warning: the robot tips over at a smaller angle than required.
SHAKY = GOOD.replace("name: good", "name: shaky\ndesign: {minimum_tip_over_angle: 60 deg}")


needs_tools = pytest.mark.skipif(not any(tools()), reason="the folders of all tools are deleted")


class Result(NamedTuple):
    status: int
    out: str
    err: str


Command = Callable[..., Result]


@pytest.fixture
def thorvaldc(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    """``thorvaldc("check", "robot.yaml")`` in a folder with good.yaml, bad.yaml and shaky.yaml."""
    return run_in_this_process(monkeypatch, tmp_path)


def run_in_this_process(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Command:
    """Returns the function of the fixture ``thorvaldc``, for a fixture of a module."""
    monkeypatch.chdir(folder)
    for name in ("NO_COLOR", "FORCE_COLOR", "THORVALDC_TRACEBACK"):
        monkeypatch.delenv(name, raising=False)
    for name, text in (("good", GOOD), ("bad", BAD), ("shaky", SHAKY)):
        Path(f"{name}.yaml").write_text(text, encoding="utf-8")

    def run(*arguments: str) -> Result:
        monkeypatch.setattr("sys.argv", ["thorvaldc", *arguments])
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = run_command()
        if "No such command" in err.getvalue() and not any(tools()):
            pytest.skip("the folders of all tools are deleted")
        return Result(status, out.getvalue(), err.getvalue())

    return run
