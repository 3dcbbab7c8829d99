"""The package of examples/odrive, installed for one test."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.examples import FOLDER

PACKAGE = FOLDER / "odrive"


@pytest.fixture
def odrive_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Installs the package: its entry points come from its ``pyproject.toml``.

    The value is the list of folders that ``PYTHONPATH`` needs.
    """
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "site" / "thorvaldc_odrive-1.dist-info"
    info.mkdir(parents=True)
    info.joinpath("METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = [
        line
        for group, entries in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()))
    ]
    info.joinpath("entry_points.txt").write_text("\n".join(lines))
    folders = [str(PACKAGE), str(info.parent)]
    for folder in folders:
        monkeypatch.syspath_prepend(folder)
    yield folders
    for module in [name for name in sys.modules if name.split(".")[0] == "thorvaldc_odrive"]:
        del sys.modules[module]
