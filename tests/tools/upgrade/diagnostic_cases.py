"""Runs the cases of tests/diagnostics that upgrade the file ``entry``."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.tools.upgrade.file_upgrade import upgrade_file

COMMANDS = {"upgrade": lambda case, entry: upgrade_file(Path(entry)).report}
