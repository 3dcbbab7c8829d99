"""The files that belong to a robot file, which the service of a robot builds."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from thorvaldc.backends.can.canmap import canmap_text
from thorvaldc.compiler.modules.fetched_library import cache_folder
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.source.readable_folders import is_below
from thorvaldc.diagnostics import OutsideError
from thorvaldc.model import Robot
from thorvaldc.tools.computer.installed_versions import (
    CACHE,
    Version,
    files_below,
    version_with,
    write_version,
)

MOST_FILES, MOST_BYTES = 5_000, 500_000_000
"""Limits of the files beside a robot file that belong to it."""


def files_of(
    path: Path, sources: Mapping[str, Path], left_out: Path
) -> tuple[Path, dict[str, Path]]:
    """Returns the folder that contains a robot file with all that it names, and its files.

    The folder is that of the robot file, or the nearest one above it with the libraries and
    designs that the robot file names.  Hidden files, builds, and links that lead out of the folder
    are left out: root can read what the owner of the files cannot, and everybody can read the copy.

    - ``sources``: source files by the names in diagnostics; those of the built-in library begin
      with `<`.
    - ``left_out``: a folder that is no part of the robot.

    Raises ``OutsideError`` if the folder is too large.
    """
    own = [path, *(p for name, p in sources.items() if name[:1] not in ("<", "/"))]
    root = Path(os.path.commonpath([os.path.realpath(p.parent) for p in own]))
    files: dict[str, Path] = {}
    size = 0
    for folder, folders, names in os.walk(root):
        is_build = "manifest.json" in names and "model.json" in names
        if is_build or os.path.realpath(folder) == os.path.realpath(left_out):
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if name[0] != "." and name != "__pycache__")
        for name in sorted(names):
            file = Path(folder) / name
            if name[0] == "." or not file.is_file() or not is_below(file, [str(root)]):
                continue
            size += file.stat().st_size
            files[file.relative_to(root).as_posix()] = file
            if len(files) > MOST_FILES or size > MOST_BYTES:
                raise OutsideError(
                    f"the folder {root} has more than {MOST_FILES} files or "
                    f"{MOST_BYTES // 1_000_000} MB: put the robot file into a folder with its"
                    " modules and meshes alone"
                )
    return root, files


def version_of(robot: Robot, path: Path, sources: Mapping[str, Path], left_out: Path) -> Version:
    """Returns the version of a robot that a robot file describes.

    - ``sources``, ``left_out``: as for ``files_of``.

    Raises ``OutsideError`` if the robot has no files for a computer, or if the robot file does not
    describe the same robot without the files of other folders.
    """
    root, files = files_of(path, sources, left_out)
    content = {f"files/{name}": file.read_bytes() for name, file in files.items()}
    # The service reads the libraries of repositories from a cache of its own.
    cache = cache_folder()
    for source in sources.values():
        if cache in source.parents:
            library = cache / source.relative_to(cache).parts[0]
            for name, file in files_below(library):
                content[f"{CACHE}/{library.name}/{name}"] = file.read_bytes()
    folder = Path(os.path.realpath(path.parent)).relative_to(root).as_posix()
    version = version_with(robot, content, folder, path.name)
    with tempfile.TemporaryDirectory(prefix="thorvaldc-install-") as temporary:
        write_version(version, Path(temporary))
        copy = compile_file(Path(temporary, "files", folder, path.name))
    if not isinstance(copy.model, Robot) or canmap_text(copy.model) != canmap_text(robot):
        reason = next((f" ({error.message})" for error in copy.report.errors), "")
        raise OutsideError(
            f"{path} does not compile to the same robot without files of other folders{reason}: put"
            f" what it names below {root}"
        )
    return version
