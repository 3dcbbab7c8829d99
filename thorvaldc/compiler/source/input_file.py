"""Reads the bytes of an input file, and reports an error if the file is not readable.

An editor can replace the text of files by the text that the user has not saved yet.  Only YAML and
CSV documents can be replaced: worker processes read xacro files and meshes from the disk.

If the path in a document does not exist, a hint names the file or folder that it probably means.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from thorvaldc.compiler.source.node import Node, yaml_text
from thorvaldc.compiler.source.readable_folders import is_below, real_folders
from thorvaldc.diagnostics import Proposal, Report, Span, nearest
from thorvaldc.diagnostics.files import read_bounded

_unsaved: ContextVar[Mapping[str, bytes]] = ContextVar("unsaved")


@contextmanager
def unsaved_texts(texts: Mapping[str, bytes]) -> Iterator[None]:
    """Replaces the content of files in this thread within the ``with`` block.

    Texts of an outer ``with`` block remain replaced.

    - ``texts``: content by the path of the file, as ``os.path.realpath`` returns it.
    """
    token = _unsaved.set({**_unsaved.get({}), **texts})
    try:
        yield
    finally:
        _unsaved.reset(token)


def unsaved_text(path: Path) -> bytes | None:
    """Returns the unsaved content of a file, or ``None`` if the file on the disk is to be read."""
    texts = _unsaved.get(None)
    return texts.get(os.path.realpath(path)) if texts else None


def folder_of(node: Node, files: Mapping[str, Path], folder: Path) -> Path:
    """Returns the folder to which a path in a document is relative: that of the file with the path.

    ``files``: paths by their names in spans.  ``folder``: that of a path that no file contains.
    """
    return files[node.span.file].parent if node.span.file in files else folder


def check_no_link_outside(
    path: Path, folder: Path, display: str, report: Report, span: Span | None = None
) -> bool:
    """Returns whether a file is in a folder after its links, and reports an error if not."""
    if is_below(path, real_folders([folder])):
        return True
    report.add(
        "file-unreadable",
        f"`{display}` cannot be read: it is a link to a file outside of its folder",
        span or Span(display),
        hint="copy the file to the place of the link",
    )
    return False


def read_bytes(
    path: Path,
    display: str,
    report: Report,
    *,
    limit: int,
    cut: bool = False,
    folder_hint: str | None = None,
) -> bytes | None:
    """Returns the bytes of an input file.

    If the file cannot be read, adds an error to ``report`` and returns ``None``.

    - ``display``: name of the file in messages.
    - ``limit``: maximum number of bytes in the file.
    - ``cut``: whether only the first ``limit`` bytes of a larger file are returned.
    - ``folder_hint``: hint of the diagnostic if the path is a folder.
    """
    text = unsaved_text(path)
    if text is not None and (cut or len(text) <= limit):
        return text[:limit]
    try:
        return read_bounded(path, limit, cut=cut)
    except FileNotFoundError:
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
    except IsADirectoryError:
        message = f"`{display}` is a folder; expected a file"
        report.add("file-is-a-directory", message, Span(display), hint=folder_hint)
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        report.add("file-unreadable", f"`{display}` cannot be read: {reason}", Span(display))
    return None


# -- similar paths ----------------------------------------------------------------

DOCUMENTS = ("yaml", "yml")
XACRO_FILES = ("xacro", "urdf", "xml")
LOGS = ("csv", "mcap", "db3")
FOLDERS = ()
"""Stands for the suffixes of a path that names a folder."""

MAX_ENTRIES = 500
"""Greatest number of entries of a folder that are compared, and of subfolders that are searched."""


def report_missing(
    code: str,
    folder: Path,
    node: Node,
    suffixes: Sequence[str],
    report: Report,
    otherwise: str = "the path is relative to this file",
) -> None:
    """Reports that the file or folder that a document names does not exist.

    ``folder``, ``node``, ``suffixes`` and ``otherwise``: as for ``missing_file_hint``.
    """
    message = f"there is no {'file' if suffixes else 'folder'} `{node.value}`"
    hint = missing_file_hint(folder, node, suffixes, otherwise)
    report.add(code, message, node.span, hint=hint)


def missing_file_hint(folder: Path, node: Node, suffixes: Sequence[str], otherwise: str) -> str:
    """Returns the hint for a path in a document that does not exist.

    If a similar path exists, the hint is a ``Proposal`` of this path.

    - ``folder``: folder to which the path is relative.
    - ``node``: YAML node that contains the path.
    - ``suffixes``: suffixes of the expected files without the dot, or ``FOLDERS``.
    - ``otherwise``: hint if no similar path exists.
    """
    path = near_path(folder, str(node.value), suffixes)
    if os.path.isdir(folder / str(node.value)):
        inside = _listing(folder / str(node.value), suffixes)
        path = f"{str(node.value).rstrip('/')}/{inside[0]}" if len(inside) == 1 else None
        otherwise = "this is a folder; name the file in it"
    if path is None:
        return otherwise
    return Proposal(f"did you mean `{path}`?", yaml_text(path))


def near_path(folder: Path, name: str, suffixes: Sequence[str]) -> str | None:
    """Returns the existing path that is most similar to ``name``, or ``None``.

    The parts of the path are compared one after another with the listings of the folders.  If a
    part has no similar name, the file is searched in the folder and its subfolders.  The parameters
    are those of ``missing_file_hint``.
    """
    name = name.strip().replace("\\", "/")
    if not name or name.startswith(("/", "~")) or len(name) > 300 or "\0" in name:
        return None
    parts_of_name = [part for part in name.split("/") if part not in ("", ".")]
    current, existing_parts = folder, []
    for number, part in enumerate(parts_of_name, 1):
        is_last = number == len(parts_of_name)
        choices = _listing(current, suffixes if is_last else FOLDERS)
        match = part if part in choices or part == ".." else _nearest_file(part, choices)
        if match is None:
            return _elsewhere(folder, parts_of_name[-1], suffixes)
        existing_parts.append(match)
        current = current / match
    return "/".join(existing_parts)


def _nearest_file(name: str, choices: Sequence[str]) -> str | None:
    """Returns the most similar file name.  The suffixes are compared only after the stems, because
    a common suffix makes different names of files similar."""
    by_stem: dict[str, list[str]] = {}
    for choice in choices:
        by_stem.setdefault(choice.rpartition(".")[0] or choice, []).append(choice)
    stem = nearest(name, by_stem) or nearest(name.rpartition(".")[0] or name, by_stem)
    return nearest(name, by_stem[stem]) or by_stem[stem][0] if stem is not None else None


def _elsewhere(folder: Path, name: str, suffixes: Sequence[str]) -> str | None:
    """Returns the path of a file with this name in the folder or in one of its subfolders."""
    if not suffixes:
        return None
    subfolders = [Path(), *map(Path, _listing(folder, FOLDERS))]
    for first in list(subfolders[1:]):
        subfolders += [first / second for second in _listing(folder / first, FOLDERS)]
    for subfolder in subfolders[:MAX_ENTRIES]:
        if name in _listing(folder / subfolder, suffixes):
            return (subfolder / name).as_posix()
    return None


def _listing(folder: Path, suffixes: Sequence[str]) -> list[str]:
    """Returns the names of the files with one of the suffixes in a folder, or of the folders.

    The names are sorted.  A folder with more than ``MAX_ENTRIES`` entries has an empty listing, so
    that the hint does not depend on the order of the entries in the file system.
    """
    try:
        with os.scandir(folder) as listing:
            entries = list(itertools.islice(listing, MAX_ENTRIES + 1))
        return sorted(_names(entries, suffixes)) if len(entries) <= MAX_ENTRIES else []
    except (OSError, ValueError):
        return []


def _names(entries: Iterable[os.DirEntry[str]], suffixes: Sequence[str]) -> Iterator[str]:
    for entry in entries:
        suffix = entry.name.rpartition(".")[2].lower()
        if not entry.name.startswith(".") and (
            (suffix in suffixes and entry.is_file()) if suffixes else entry.is_dir()
        ):
            yield entry.name
