"""Reads the bytes of an input file, and reports an error if the file is not readable."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.bounded_file import read_bounded


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
