"""A robot and the file system of its computer."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command


@pytest.fixture
def root(tmp_path: Path, thorvaldc: Command) -> Path:
    """The file system of a computer, and a folder with a robot of its own."""
    Path("own").mkdir()
    Path("own/good.yaml").write_text(GOOD, encoding="utf-8")
    os.chdir("own")
    (tmp_path / "root/etc").mkdir(parents=True)
    return tmp_path / "root"
