"""The documentation as a site: it builds without a warning, and its links lead somewhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.site_pages import dead_links, foreign_files

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.xdist_group("site"), pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
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
    return folder


def test_every_link_and_anchor_exists(site: Path) -> None:
    assert list(dead_links(site)) == []


def test_nothing_is_loaded_from_another_host(site: Path) -> None:
    assert list(foreign_files(site)) == []


def test_the_check_of_links_finds_dead_ones(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1> <a href="#top">1</a> <a href="#bottom">2</a> <a href="b.html">3</a>'
        '<img src="c.png"> <script src="https://cdn.example/x.js"></script>'
    )
    assert list(dead_links(tmp_path)) == ["a.html: #bottom", "a.html: b.html", "a.html: c.png"]
    assert list(foreign_files(tmp_path)) == ["a.html: https://cdn.example/x.js"]
