"""The package of examples/vesc, installed for one test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.example_packages import installed


@pytest.fixture
def vesc_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The list of folders that ``PYTHONPATH`` needs."""
    yield from installed("vesc", tmp_path, monkeypatch)
