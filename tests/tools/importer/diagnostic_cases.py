"""Runs the cases of tests/diagnostics that import."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.tools.importer.original_import import import_original

COMMANDS = {"import": lambda case, entry: import_original(Path(entry)).report}
