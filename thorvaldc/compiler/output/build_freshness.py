"""Compares a build folder with the files that a build would write now.

For repositories that contain their builds.

Nothing is written.  Files in the folder that are not of a build belong to the user and are ignored.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.compiler.output.writer import MANIFEST, listed_files, manifest
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Span
from thorvaldc.diagnostics.files import read_bounded, read_json

_SHOWN = 8
"""Number of file names of each kind in a message."""


class BuildDifference(NamedTuple):
    """Files of a build folder that differ from those of a new build, by relative path.

    - ``missing``: files that are not there.
    - ``changed``: files with other bytes.
    - ``extra``: files of an earlier build that a new build removes.
    - ``line_endings``: whether the changed files differ only in their line endings.
    """

    missing: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    extra: tuple[str, ...] = ()
    line_endings: bool = False

    def __bool__(self) -> bool:
        return bool(self.missing or self.changed or self.extra)

    def as_json(self) -> dict[str, Any]:
        """Returns the difference as JSON values."""
        lists = {"missing": self.missing, "changed": self.changed, "extra": self.extra}
        return {"fresh": not self} | {kind: list(paths) for kind, paths in lists.items()}

    def __str__(self) -> str:
        kinds = (("changed", self.changed), ("missing", self.missing), ("extra", self.extra))
        return "; ".join(f"{kind}: {_shortened(paths)}" for kind, paths in kinds if paths)


def build_difference(files: Mapping[str, bytes], folder: Path) -> BuildDifference:
    """Compares a folder with the files of a new build, which include the manifest."""
    missing, changed, has_other_text = [], [], False
    for path in sorted(files):
        present = _content(folder / path, len(files[path]))
        if present is None:
            missing.append(path)
        elif present != files[path]:
            changed.append(path)
            # The manifest of a build with other line endings is text with other line endings too.
            has_other_text |= present.replace(b"\r\n", b"\n") != files[path]
    listed = listed_files(folder) or {}
    extra = [
        path for path in sorted(listed) if path not in files and os.path.lexists(folder / path)
    ]
    return BuildDifference(
        tuple(missing), tuple(changed), tuple(extra), bool(changed) and not has_other_text
    )


def check_freshness(
    compilation: Compilation,
    files: Mapping[str, bytes],
    folder: Path,
    *,
    file: str,
    command: str,
    version: str,
) -> BuildDifference:
    """Reports (``build-stale``) if a build folder or a lock file is not that of the present input.

    Parameters
    ----------
    compilation : the compilation without errors; its report receives the diagnostics.
    files : content of each file of the build, by relative path.
    folder : the build folder.
    file : path of the compiled file, for the span of the diagnostic.
    command : the command that writes the build, for the hint.
    version : version of the compiler.
    """
    assert compilation.model is not None
    expected = dict(files)
    expected[MANIFEST] = manifest(
        files,
        name=compilation.model.name,
        source_sha256=compilation.source_sha256,
        version=version,
    )
    report, span = compilation.report, Span(os.path.normpath(file))
    for path in compilation.locks:
        report.add(
            "build-stale",
            f"the lock file `{os.path.normpath(path)}` is not that of the present robot",
            span,
            hint=f"write it again and commit it: {command}",
        )
    difference = build_difference(expected, folder)
    if difference:
        report.add(
            "build-stale",
            _message(difference, folder),
            span,
            hint=_hint(difference, folder, command, version),
        )
    return difference


def _message(difference: BuildDifference, folder: Path) -> str:
    if listed_files(folder) is None and not difference.changed:
        return f"there is no build in `{folder}`"
    return f"the build in `{folder}` is not that of the present file: {difference}"


def _hint(difference: BuildDifference, folder: Path, command: str, version: str) -> str:
    if difference.line_endings and not (difference.missing or difference.extra):
        return (
            f"only the line endings differ: write `{folder.as_posix()}/** -text` into"
            f" .gitattributes and build again: {command}"
        )
    other = _compiler(folder)
    made_by = f"it was made by {other}, this is thorvaldc {version}; " if other else ""
    made_by = "" if other == f"thorvaldc {version}" else made_by
    return f"{made_by}write it again and commit it: {command}"


def _compiler(folder: Path) -> str:
    """Returns the compiler and version that a manifest names, or ``""``."""
    content = _content(folder / MANIFEST, 16_000_000)
    try:
        compiler = read_json(content or b"{}").get("compiler", "")
    except (ValueError, AttributeError):
        return ""
    return compiler if isinstance(compiler, str) else ""


def _content(path: Path, size: int) -> bytes | None:
    """Returns the bytes of a file, cut after twice the expected size; ``None`` without a file."""
    try:
        return read_bounded(path, 2 * size + 1000, cut=True)
    except FileNotFoundError:
        return None
    except OSError:
        return b"" if os.path.lexists(path) and not path.is_dir() else None


def _shortened(paths: tuple[str, ...]) -> str:
    more = len(paths) - _SHOWN
    return ", ".join(paths[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
