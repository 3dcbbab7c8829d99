"""The lock file of a robot: `robot.lock.yaml` keeps what was chosen once for `robot.yaml`.

It has the node ids that the compiler chose (``bus.node_ids``), and the content of each library
that was fetched (``modules.fetched_library``)::

    thorvaldc_lock: 1
    libraries:
      - {git: "https://example.org/agri.git", tag: v1.2, commit: 4f1c..., sha256: 9e2b...}
    addresses:
      main:
        canopen:
          fl.controller: 3
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report

VERSION_KEY, VERSION = "thorvaldc_lock", 1
ADDRESSES, LIBRARIES = "addresses", "libraries"
_HEAD = """\
# Ids that thorvaldc chose for the devices of {robot} (`can: auto`). `thorvaldc build` keeps this
# file up to date. Keep it with the robot: with it a new module never takes another's id.
"""
_LIBRARIES = "# `thorvaldc modules fetch` writes these lines.\n"


def lock_path(robot: Path) -> Path:
    """Returns the path of the lock file of a robot, such as `robot.lock.yaml` for `robot.yaml`."""
    return robot.with_name(f"{robot.stem}.lock.yaml")


def without_lock_files(files: Sequence[str]) -> list[str]:
    """Returns the paths without those of the lock files of robots among them.

    The pattern `robots/*.yaml` also names lock files; the compiler reads them with their robots.
    """
    locks = {lock_path(Path(file)) for file in files if Path(file).name}
    return [file for file in files if Path(file) not in locks]


def is_lock(document: Node, report: Report) -> bool:
    """Returns whether a document is a lock file of this version, and reports an error if not."""
    version = document.get(VERSION_KEY)
    if version is not None and type(version.value) is int and version.value == VERSION:
        return True
    message = f"this is not a lock file with `{VERSION_KEY}: {VERSION}`"
    report_invalid(message, version or document, report)
    return False


def report_invalid(message: str, node: Node, report: Report) -> None:
    """Reports an error in a lock file."""
    hint = "restore the file from version control, or delete it to choose all ids again"
    report.add("can-lock-invalid", message, node.span, hint=hint)


def lock_text(robot: str, libraries: Iterable[str], addresses: Iterable[str]) -> str:
    """Returns the YAML text of a lock file.

    - ``robot``: name of the robot file, for the comment at the start of the lock file.
    - ``libraries``, ``addresses``: lines of the two sections.
    """
    pins, ids = "".join(libraries), "".join(addresses)
    text = f"{_HEAD.format(robot=robot)}{VERSION_KEY}: {VERSION}\n"
    if pins:
        text += f"{_LIBRARIES}{LIBRARIES}:\n{pins}"
    return text + (f"{ADDRESSES}:\n{ids}" if ids else f"{ADDRESSES}: {{}}\n")
