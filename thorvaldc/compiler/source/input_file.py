"""Reads the bytes of an input file and reports why it cannot be read."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics import Report, Span


def read_bytes(
    path: Path, display: str, report: Report, *, limit: int = -1, folder_hint: str | None = None
) -> bytes | None:
    """Returns the first ``limit`` bytes of a file (default: all); ``None`` on an error.

    ``display`` is the name of the file in messages; ``folder_hint`` is the hint if the path
    is a folder.
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
