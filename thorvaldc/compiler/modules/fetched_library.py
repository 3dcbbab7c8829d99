"""Libraries of modules from repositories and archives.

An entry of `library` such as `{git: URL, tag: v1.2}` names one.  `thorvaldc modules fetch` copies
its files into the cache and pins their content in the lock file::

    robot.yaml       library: [{git: URL, tag: v1.2}]
    robot.lock.yaml  libraries: [{git: URL, tag: v1.2, commit: 4f1c..., sha256: 9e2b...}]
    cache            ~/.cache/thorvaldc/libraries/9e2b.../drive/mine/module.yaml

The compiler reads the cache alone.  Each process compares the content of all files with the pin
once, and again when the name, the size or the time of a file has changed.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.source.input_file import check_no_link_outside
from thorvaldc.compiler.source.lock_file import LIBRARIES, is_lock, lock_path, report_invalid
from thorvaldc.compiler.source.node import Node, yaml_text
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import Report

MAX_FILES = 10_000
MAX_BYTES = 100_000_000
"""Limits of the files of a library, together."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_SUFFIX = re.compile(r"(\.git|\.tar\.gz|\.tgz|\.zip)?/*$")


class FetchedLibrary(NamedTuple):
    """A repository or an archive with modules, as a robot file names it.

    - ``git``, ``tag``: URL of a repository and its tag, or empty.
    - ``archive``: URL of an archive, or its path relative to the file; or empty.
    - ``folder``: folder of the modules in it, or empty for its top folder.
    """

    git: str
    tag: str
    archive: str
    folder: str

    @property
    def name(self) -> str:
        """Name for people: the last part of the URL or path, and the tag."""
        last = _SUFFIX.sub("", self.git or self.archive).replace("\\", "/").rpartition("/")[2]
        name = re.sub(r"[^\w.+-]", "_", last) or "library"
        return f"{name}@{self.tag}" if self.tag else name

    @property
    def document(self) -> dict[str, str]:
        """The keys of the entry with their values."""
        return {key: value for key, value in self._asdict().items() if value}


class LibraryPin(NamedTuple):
    """A library in the lock file: its commit, or empty for an archive, and its content."""

    library: FetchedLibrary
    commit: str
    sha256: str

    @property
    def display(self) -> str:
        """Name of the folder in diagnostics, as that of the built-in library begins with ``<``."""
        version = "" if self.library.tag else f"@{self.sha256[:8]}"
        return f"<{self.library.name}{version}>"

    @property
    def document(self) -> dict[str, str]:
        """The keys of the entry in the lock file with their values."""
        commit = {"commit": self.commit} if self.commit else {}
        return self.library.document | commit | {"sha256": self.sha256}

    @property
    def line(self) -> str:
        """Line of the lock file."""
        return f"  - {yaml_text(self.document)}\n"

    @property
    def version(self) -> str:
        """Commit or content for people."""
        return f"commit {self.commit[:12]}" if self.commit else f"content {self.sha256[:12]}"

    @property
    def origin(self) -> str:
        """Address and version for people."""
        return f"{self.library.git or self.library.archive}, {self.version}"


def cache_folder() -> Path:
    """Returns the folder of all fetched libraries; each is in a folder named by its content."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(cache) / "thorvaldc" / "libraries"


def fetched_libraries(document: Node) -> Iterator[tuple[FetchedLibrary, Node]]:
    """Yields the repositories and archives of a robot file, with their entries."""
    for node in items(document.get("library")):
        if (library := _library_of(node)) is not None:
            yield library, node


def _library_of(node: Node) -> FetchedLibrary | None:
    """Returns the library of an entry, or ``None`` for a folder and for an invalid entry."""
    nodes = [node.get(key) for key in FetchedLibrary._fields]
    values = [node.value if node is not None else "" for node in nodes]
    if not all(isinstance(value, str) for value in values):
        return None
    library = FetchedLibrary(*map(str, values))
    return library if (library.git and library.tag) or library.archive else None


def read_pins(robot: Path, name: str, report: Report) -> list[LibraryPin]:
    """Returns the libraries that the lock file of a robot file pins.

    ``name``: name of the robot file in diagnostics.
    """
    path, display = lock_path(robot), lock_path(Path(name)).as_posix()
    if not os.path.lexists(path):
        return []
    if not check_no_link_outside(path, path.parent, display, report):
        return []
    document = read_file(path, display, report)
    if document is None or not is_lock(document, report):
        return []
    section, pins = document.get(LIBRARIES), list[LibraryPin]()
    if section is not None and not isinstance(section.value, tuple):
        report_invalid("expected a list of libraries", section, report)
        return []
    for node in items(section):
        library = _library_of(node)
        commit, sha256 = (str(n.value) if n else "" for n in map(node.get, ("commit", "sha256")))
        if library is None or not _SHA256.fullmatch(sha256):
            report_invalid("expected a library with its `sha256`", node, report)
        else:
            pins.append(LibraryPin(library, commit, sha256))
    return pins


def pinned_folder(
    library: FetchedLibrary, node: Node, robot: Path, report: Report
) -> tuple[Path, str] | None:
    """Returns the folder of a library in the cache, and its name in diagnostics.

    Reports an error at the entry ``node`` and returns ``None`` if the library is not pinned, not in
    the cache, or has another content there.  ``robot``: path of the file with the entry.
    """
    pins = read_pins(robot, node.span.file, report)
    pin = next((pin for pin in pins if pin.library == library), None)
    hint = f"run `thorvaldc modules fetch {robot}`"
    if pin is None:
        message = f"the library `{library.name}` is not pinned in `{lock_path(robot).name}`"
        report.add("library-not-fetched", message, node.span, hint=hint)
        return None
    folder = cache_folder() / pin.sha256
    if not os.path.isdir(folder):
        message = f"the library `{library.name}` is not in the cache of this user"
        report.add("library-not-fetched", message, node.span, hint=hint)
        return None
    if not is_intact(folder, pin.sha256):
        message = (
            f"the files of `{library.name}` in the cache are not those that"
            f" `{lock_path(robot).name}` pins"
        )
        report.add("library-changed", message, node.span, hint=f"{hint}, which fetches them again")
        return None
    return folder, pin.display


# -- the content of a folder ------------------------------------------------------------

_Listing = tuple[tuple[str, int, int], ...]
_intact: dict[tuple[str, str], _Listing] = {}


def is_intact(folder: Path, sha256: str) -> bool:
    """Returns whether the files of a folder have the content of a pin."""
    key = (str(folder), sha256)
    try:
        listing = _listing(folder)
        if _intact.get(key) != listing:
            if _hash(folder, listing) != sha256:
                return False
            _intact[key] = listing
    except OSError:
        return False
    return True


def content_sha256(folder: Path) -> str:
    """Returns the SHA-256 of the names and contents of all files in a folder.

    Raises ``OSError`` if a file cannot be read.
    """
    return _hash(folder, _listing(folder))


def _listing(folder: Path) -> _Listing:
    """Returns the path, the size and the time of change (ns) of each file in a folder, sorted."""

    def walk() -> Iterator[tuple[str, int, int]]:
        for root, folders, files in os.walk(folder):
            for name in (*files, *(f for f in folders if os.path.islink(os.path.join(root, f)))):
                path = os.path.join(root, name)
                status = os.lstat(path)
                if not stat.S_ISREG(status.st_mode):
                    raise OSError(f"{path} is no file")
                relative = os.path.relpath(path, folder).replace(os.sep, "/")
                yield relative, status.st_size, status.st_mtime_ns

    return tuple(sorted(itertools.islice(walk(), MAX_FILES + 1)))


def _hash(folder: Path, listing: Iterable[tuple[str, int, int]]) -> str:
    digest = hashlib.sha256()
    for name, _, _ in listing:
        digest.update(os.fsencode(name) + b"\0")
        with open(folder / name, "rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
