"""Runs the cases of tests/diagnostics that read ``entry`` as an input of `diff`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tests.repository import commit_all, lose_files
from thorvaldc.diagnostics import Report
from thorvaldc.tools.comparison.compared_inputs import read_input


def _read(case: dict[str, Any], entry: str) -> Report:
    """``git``: the files are ``committed`` (default), lost (``damaged``), or in no repository."""
    git = case.get("git", "committed")
    if git != "none":
        commit_all(Path())
    if git == "damaged":
        lose_files(Path())
    with ExitStack() as temporary:
        return read_input(entry, temporary).report


COMMANDS = {"diff": _read}
