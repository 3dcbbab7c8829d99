"""Reads the lock file beside a robot file, and computes the new text of the lock file.

The lock file contains the CANopen node ids that the compiler chose automatically.
"""

from __future__ import annotations

import os
from pathlib import Path

from thorvaldc.compiler.bus.lock_file import Lock, has_pins, lock_path, lock_text, read_lock
from thorvaldc.compiler.result.compilation import Compilation, SourceFile
from thorvaldc.compiler.source.reader import MAX_BYTES, read_file
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.bounded_file import read_bounded
from thorvaldc.model import Robot


def read_robot_lock(source: SourceFile, compilation: Compilation, report: Report) -> Lock | None:
    """Returns the node ids in a robot's lock file, or ``None`` if the robot has no lock file."""
    path = lock_path(source.path)
    if not os.path.lexists(path):
        return None
    compilation.sources[os.path.normpath(path)] = path
    document = read_file(path, lock_path(Path(source.name)).as_posix(), report)
    return read_lock(document, report) if document is not None else {}


def update_robot_lock(source: SourceFile, robot: Robot, compilation: Compilation) -> str:
    """Returns the new text of the lock file, or ``""`` if the robot needs no lock file.

    If the new text differs from the lock file on the disk, the new text is added to
    ``compilation.locks``.
    """
    path = lock_path(source.path)
    was_read = os.path.normpath(path) in compilation.sources
    if not was_read and not has_pins(robot):
        return ""
    text = lock_text(robot, source.path.name)
    if not was_read or read_bounded(path, MAX_BYTES + 1, cut=True) != text.encode():
        compilation.locks[path] = text
    return text
