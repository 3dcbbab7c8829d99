"""The site of the documentation, with the playground in it, built once for all tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
_sites: list[Path] = []


def built_site(factory: pytest.TempPathFactory) -> Path:
    """Returns the folder of the site; the tests of the group `site` run in one process."""
    if not _sites:
        folder = factory.mktemp("site")
        build = subprocess.run(
            [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert build.returncode == 0, build.stderr
        assert "WARNING" not in build.stderr, build.stderr
        _sites.append(folder)
    return _sites[0]
