"""Finds the folders of ROS packages, and files in folders."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path


def is_below(path: str, folders: Sequence[str]) -> bool:
    """Whether a path is one of the folders or below one.  All of them have no links."""
    return any(path == folder or path.startswith(os.path.join(folder, "")) for folder in folders)


def find_package(
    name: str,
    packages: dict[str, str],
    search: dict[str, Sequence[str]],
    near: str,
) -> str | None:
    """Returns the folder of a ROS package, or ``None`` if the package is not found.

    Search order for a ROS package:

    1. the folders in ``packages``, which the robot file sets
    2. the folders ``share/<name>`` in the install prefixes ``search["ament"]``
    3. the folders ``search["ros"]``, which are packages or contain packages
    4. the parent folders of the file ``near``, and the subfolders of these folders
    """
    if name in packages:
        return packages[name]
    for prefix in search["ament"]:
        folder = os.path.join(prefix, "share", name)
        if os.path.isdir(folder):
            return folder
    for root in search["ros"]:
        for folder in (root, os.path.join(root, name)):
            if os.path.basename(folder) == name and os.path.isdir(folder):
                return folder
    for above in Path(near).absolute().parents:
        if above.name == name:
            return str(above)
        if (above / "package.xml").is_file():
            declared = re.search(
                r"<name>\s*([^<\s]+)\s*</name>",
                (above / "package.xml").read_text("utf-8", "replace"),
            )
            if declared is not None and declared[1] == name:
                return str(above)
        if (above / name / "package.xml").is_file():
            return str(above / name)
    return None


MAX_SOURCE_FOLDERS = 3000


def find_in_sources(folder: str, rest: str) -> str | None:
    """Returns the file of the path ``rest`` in the source folder of a package.

    A package can install `description/urdf/` as `urdf/`.  If the path does not exist in the source
    folder, returns the only file whose path ends with ``rest``, or ``None``.
    """
    path = os.path.join(folder, rest)
    if os.path.exists(path):
        return path
    ending = os.path.join(os.sep, os.path.normpath(rest))
    matches: list[str] = []
    for count, (inner, folders, files) in enumerate(os.walk(folder)):
        if count > MAX_SOURCE_FOLDERS:
            return None
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if os.path.basename(rest) in files:
            candidate = os.path.join(inner, os.path.basename(rest))
            matches += [candidate] if candidate.endswith(ending) else []
    return matches[0] if len(matches) == 1 else None
