"""Reads the bytes of an input file, and reports an error if the file is not readable.

An editor can replace the text of files by the text that the user has not saved yet.  Only YAML and
CSV documents can be replaced: worker processes read xacro files and meshes from the disk.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.bounded_file import read_bounded

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
