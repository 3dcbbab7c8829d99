"""Keeps the files of a folder in the folder: a link in it must not lead to another file.

A robot, its modules and its xacro files often come from others.  A link among them to a file of the
system would show parts of that file in diagnostics and copy it into builds.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path


def real_folders(folders: Iterable[Path | str]) -> list[str]:
    """Returns the absolute paths of folders without links, sorted."""
    return sorted({os.path.realpath(folder) for folder in folders})


def is_below(path: Path | str, folders: Sequence[str]) -> bool:
    """Whether a path, after its links, is one of the folders or below one.

    - ``folders``: result of ``real_folders``.
    """
    path = os.path.realpath(path)
    return any(path == folder or path.startswith(os.path.join(folder, "")) for folder in folders)
