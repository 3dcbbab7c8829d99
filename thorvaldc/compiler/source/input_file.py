"""Reads the bytes of an input file, and reports an error if the file is not readable."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics import Report, Span


def read_bytes(
    path: Path, display: str, report: Report, *, limit: int = -1, folder_hint: str | None = None
) -> bytes | None:
    """Returns the bytes of an input file.

    If the file cannot be read, adds an error to ``report`` and returns ``None``.

    - ``display``: name of the file in messages.
    - ``limit``: maximum number of bytes to read.  If the limit is negative, the whole file is read.
    - ``folder_hint``: hint of the diagnostic if the path is a folder.
    """
    try:
        with path.open("rb") as file:
            return file.read(limit)
    except FileNotFoundError:
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
    except IsADirectoryError:
        message = f"`{display}` is a folder; expected a file"
        report.add("file-is-a-directory", message, Span(display), hint=folder_hint)
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        report.add("file-unreadable", f"`{display}` cannot be read: {reason}", Span(display))
    return None
