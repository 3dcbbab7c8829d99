"""Robots with buses, compiled once for all tests of the simulated bus."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot

CIA402 = """
thorvaldc: 1
name: with_cia402
foreign_devices:
  sprayer:
    id: 40
    canopen: [heartbeat]
    frames:
      command: {cob_id: 0x240, direction: command, rate: 10 Hz}
      state: {cob_id: 0x1C0, direction: report, rate: 10 Hz, length: 4}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, params: &p
    {controller: controller/cia402_propulsion_steering}, can: {id: 1, serial: "0x101"}}
  fr: {type: assembly/steered_drive, mount: frame.front_right, params: *p,
    can: {id: 2, serial: "0x102"}}
  rl: {type: assembly/steered_drive, mount: frame.rear_left, params: *p,
    can: {id: 3, serial: "0x103"}}
  rr: {type: assembly/steered_drive, mount: frame.rear_right, params: *p,
    can: {id: 4, serial: "0x104"}}
  board: {type: io/board, params: {relay_1_at_start: true}, can: 32}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.285, 0.07]}, can: 1}
"""


@functools.cache
def compiled(text: str) -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.yaml"
        path.write_text(text, encoding="utf-8")
        compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), list(compilation.report)
    return compilation.model


def cia402_robot() -> Robot:
    """Returns a robot with four CiA 402 drives, an IO board, a battery and a foreign device."""
    return compiled(CIA402)
