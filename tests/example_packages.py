"""Examples that are packages of their own: installed for one test, and commands beside them."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.examples import FOLDER

ROOT = Path(__file__).parents[1]
PACKAGES = tuple(sorted(path.parent.name for path in FOLDER.glob("*/pyproject.toml")))
"""Names of the examples.  Without its package, such a robot has devices without a driver."""


def installed(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Installs the package of an example: its entry points come from its ``pyproject.toml``.

    Yields the list of folders that ``PYTHONPATH`` needs.
    """
    package = FOLDER / name
    project = tomllib.loads((package / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module = project["name"].replace("-", "_")
    info = folder / "site" / f"{module}-1.dist-info"
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
    folders = [str(package), str(info.parent)]
    for path in folders:
        monkeypatch.syspath_prepend(path)
    yield folders
    for loaded in [loaded for loaded in sys.modules if loaded.split(".")[0] == module]:
        del sys.modules[loaded]


def environment(folder: Path, *packages: str) -> dict[str, str]:
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *packages]),
        "XDG_RUNTIME_DIR": str(folder),
        "XDG_STATE_HOME": str(folder / "state"),
    }


def thorvaldc(folder: Path, packages: list[str], *arguments: str) -> tuple[int, str, str]:
    """Runs a command beside the packages; returns its exit status, stdout and stderr."""
    process = subprocess.run(
        [sys.executable, "-m", "thorvaldc", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        cwd=folder,
        env=environment(folder, *packages),
    )
    assert "Traceback" not in process.stderr
    return process.returncode, process.stdout, process.stderr
