"""The files of a library on their way into the cache.

What is fetched comes from others.  Files are written one after another into a hidden folder of the
cache, with limits, and the folder gets the name of its content in one step.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from thorvaldc.compiler.modules.fetched_library import (
    MAX_BYTES,
    MAX_FILES,
    cache_folder,
    content_sha256,
    is_intact,
)
from thorvaldc.compiler.modules.library import FILE
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.files import STAGE_PREFIX

MAX_NAME = 200  # bytes of the path of a file
_DAY = 86_400.0  # s
_POINTER = b"version https://git-lfs.github.com/spec/"


def refused(message: str, hint: str | None = None) -> DiagnosticError:
    """Returns the error that something cannot be a library."""
    return DiagnosticError("library-unusable", message, hint=hint)


class LibraryStage:
    """The hidden folder with the files of a library.

    - ``folder``: folder of the modules in the repository or archive, or empty.
    - ``work``: folder for other temporary files.
    - ``modules``: paths of all module files, also outside of ``folder``.
    """

    def __init__(self, place: Path, folder: str) -> None:
        self.folder = folder
        self.work = place / "work"
        self.modules: list[str] = []
        self._files = place / "files"
        self._count = self._bytes = 0
        self.work.mkdir()
        self._files.mkdir()

    def path_of(self, name: str) -> str | None:
        """Returns the path of a file in the library, or ``None`` if it is outside of its folder.

        ``name``: path of the file in the repository or archive.  Raises ``DiagnosticError`` if it
        leads out of the repository or archive.
        """
        parts = name.split("/")
        shown = name if len(name) <= 60 else f"{name[:57]}..."
        if not name.isprintable() or "\\" in name or any(p in ("", ".", "..") for p in parts):
            raise refused(f"it has a file with the path {shown!r}, which is not allowed")
        if any(part.lower() == ".git" for part in parts):
            raise refused(f"it has a file in a folder `.git`: {shown!r}")
        if len(os.fsencode(name)) > MAX_NAME:
            raise refused(f"it has a path with more than {MAX_NAME} bytes: {shown!r}")
        if parts[-1] == FILE and len(self.modules) < MAX_FILES:
            self.modules.append(name)
        if self.folder and not name.startswith(f"{self.folder}/"):
            return None
        return name.removeprefix(f"{self.folder}/") if self.folder else name

    def check_size(self, files: int, size: int) -> None:
        """Raises ``DiagnosticError`` if a library is too large."""
        if files > MAX_FILES or size > MAX_BYTES:
            limit = f"{MAX_FILES} files with {MAX_BYTES / 1e6:.0f} MB"
            raise refused(f"it is too large: at most {limit} are fetched")

    def add(self, path: str, parts: Iterable[bytes]) -> None:
        """Writes a file; ``path``: result of ``path_of``."""
        self._count += 1
        self.check_size(self._count, self._bytes)
        target = self._files / path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            # Nobody edits a file of the cache by mistake.
            descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o444)
        except (FileExistsError, NotADirectoryError):
            raise refused(f"it has two files at the path {path!r}") from None
        with open(descriptor, "wb") as file:
            start = b""
            for part in parts:
                self._bytes += len(part)
                self.check_size(self._count, self._bytes)
                file.write(part)
                start = start or part[: len(_POINTER)]
        if start == _POINTER:
            raise refused(f"{path!r} is a pointer of Git LFS, not the file itself")

    def keep(self) -> tuple[str, list[str]]:
        """Gives the files their place in the cache; returns their SHA-256 and the module types.

        Raises ``DiagnosticError`` if there is no module.
        """
        if self.folder and not self._count:
            raise refused(f"it has no folder `{self.folder}`", self._hint())
        start = f"{self.folder}/" if self.folder else ""
        files = [m for m in self.modules if m.startswith(start) and m.count("/") > start.count("/")]
        if not files:
            where = f"the folder `{self.folder}`" if self.folder else "it"
            raise refused(f"{where} has no modules, which are files `{FILE}`", self._hint())
        sha256 = content_sha256(self._files)
        target = cache_folder() / sha256
        if not is_intact(target, sha256):
            with contextlib.suppress(FileNotFoundError):
                os.rename(target, self.work / "damaged")
            try:
                os.rename(self._files, target)
            except OSError:
                # Another process fetched the same content at the same time.
                if not is_intact(target, sha256):
                    raise
        types = sorted(m.removeprefix(start).removesuffix(f"/{FILE}") for m in files)
        return sha256, types

    def _hint(self) -> str | None:
        """Returns the hint with the folder that has modules, such as ``modules/drive/mine``."""
        folders = dict.fromkeys("/".join(path.split("/")[:-3]) for path in sorted(self.modules))
        named = [f"`folder: {folder}`" for folder in folders if folder][:3]
        return f"name the folder with the modules: {' or '.join(named)}" if named else None


@contextmanager
def new_stage(folder: str) -> Iterator[LibraryStage]:
    """Makes a hidden folder in the cache, which is removed at the end of the block."""
    cache = cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    for old in cache.glob(f"{STAGE_PREFIX}*"):  # of a process that was killed
        with contextlib.suppress(OSError):
            if time.time() - old.stat().st_mtime > _DAY:
                shutil.rmtree(old, ignore_errors=True)
    with tempfile.TemporaryDirectory(
        prefix=STAGE_PREFIX, dir=cache, ignore_cleanup_errors=True
    ) as place:
        yield LibraryStage(Path(place), folder)
