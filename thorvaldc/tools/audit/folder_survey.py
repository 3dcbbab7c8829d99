"""Finds the files of a robot in folders, with limits on their number, depth and size."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.bounded_file import read_bounded

MAX_FILES = 3000
MAX_ENTRIES = 200_000
MAX_DEPTH = 24
MAX_BYTES = 8_000_000
MAX_TOTAL_BYTES = 200_000_000

SUFFIXES = (
    *(".urdf", ".xacro", ".sdf", ".world", ".xml", ".mjcf"),
    *(".yaml", ".yml", ".py", ".launch"),
)
_IGNORE_MARKS = ("COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE")


class RobotFile(NamedTuple):
    """A file to read; ``root`` is the folder that the user named, ``display`` its name there."""

    path: Path
    display: str
    root: Path
    root_display: str


@dataclass(slots=True)
class Survey:
    """The files of the folders that the user named, in the order of their names.

    - ``packages``: folder of each ROS package, by its name.
    """

    files: list[RobotFile] = field(default_factory=list)
    packages: dict[str, Path] = field(default_factory=dict)
    read_bytes: int = 0

    def content(self, file: RobotFile, report: Report) -> bytes | None:
        """Returns the bytes of a file, or ``None`` with a note if it cannot be read."""
        reason = f"all files together have more than {MAX_TOTAL_BYTES // 1_000_000} MB"
        if self.read_bytes < MAX_TOTAL_BYTES:
            try:
                data = read_bounded(file.path, MAX_BYTES)
            except (OSError, ValueError) as error:
                text = error.strerror if isinstance(error, OSError) else None
                reason = text or str(error)
            else:
                self.read_bytes += len(data)
                return data
        skip(file.display, reason, report)
        return None


def skip(display: str, reason: str, report: Report, span: Span | None = None) -> None:
    """Adds the note that a file, or a part of it, is not audited."""
    report.add("audit-file-skipped", f"`{display}` is not audited: {reason}", span or Span(display))


def survey(names: list[str], report: Report) -> Survey:
    """Finds the robot files in folders and adds named files; reports names that do not exist."""
    result = Survey()
    known: set[str] = set()
    for name in names:
        path = Path(name)
        if not path.exists():
            report.add("file-not-found", f"`{name}` does not exist", Span(name))
        elif path.is_dir():
            _walk(path, name, result, known, report)
        else:
            folder = path.absolute().parent
            _add(result, known, RobotFile(path.absolute(), name, folder, str(path.parent)))
            _find_package_above(folder, result)
    return result


def _add(result: Survey, known: set[str], file: RobotFile) -> None:
    real = os.path.realpath(file.path)
    if real not in known:
        known.add(real)
        result.files.append(file)


def _find_package_above(folder: Path, result: Survey) -> None:
    for above in (folder, *folder.parents):
        if (above / "package.xml").is_file():
            _read_package(above, result)
            return


def _walk(root: Path, display: str, result: Survey, known: set[str], report: Report) -> None:
    """Adds the files below a folder; links to folders are not followed."""
    root = root.absolute()
    _find_package_above(root, result)
    entries = 0
    for folder, folders, files in os.walk(root):
        entries += len(folders) + len(files)
        depth = len(Path(folder).relative_to(root).parts)
        marked = folder != str(root) and any(mark in files for mark in _IGNORE_MARKS)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if marked:
            folders.clear()
            continue
        if depth >= MAX_DEPTH and folders:
            shown = os.path.join(display, Path(folder).relative_to(root))
            _report_limit(shown, f"is more than {MAX_DEPTH} levels deep", report)
            folders.clear()
        if "package.xml" in files:
            _read_package(Path(folder), result)
        for name in sorted(files):
            path = Path(folder, name)
            if not name.endswith(SUFFIXES) or name.startswith("."):
                continue
            shown = os.path.normpath(os.path.join(display, path.relative_to(root)))
            _add(result, known, RobotFile(path, shown.replace(os.sep, "/"), root, display))
        if len(result.files) > MAX_FILES or entries > MAX_ENTRIES:
            number = f"{MAX_FILES} robot" if len(result.files) > MAX_FILES else str(MAX_ENTRIES)
            del result.files[MAX_FILES:]
            _report_limit(display, f"contains more than {number} files", report)
            return


def _report_limit(display: str, reason: str, report: Report) -> None:
    message = f"`{display}` {reason}; the rest is left out"
    report.add("audit-limit", message, Span(display), hint="name the folder of one robot in it")


def _read_package(folder: Path, result: Survey) -> None:
    try:
        text = read_bounded(folder / "package.xml", 1_000_000).decode("utf-8", "replace")
    except OSError:
        return
    name = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    if name is not None:
        result.packages.setdefault(name[1], folder)
