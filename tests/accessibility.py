"""Checks the accessibility of pages: by their elements, and in a browser with axe-core."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from tests.outside_tools import path_of, without

VOID = {"meta", "wbr"}
PACKAGE = Path(__file__).parent / "docs" / "axe"


def axe_script(folder: Path) -> str:
    """Installs axe-core in a folder and returns its text.  Skips the test if it cannot."""
    for name in ("package.json", "package-lock.json"):
        shutil.copy(PACKAGE / name, folder)
    install = subprocess.run(
        [path_of("npm"), "ci", "--ignore-scripts", "--no-audit", "--no-fund"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if install.returncode != 0:
        without(f"axe-core cannot be installed: {install.stderr[-300:]}")
    return (folder / "node_modules/axe-core/axe.min.js").read_text(encoding="utf-8")


def violations(page: Any, axe: str, label: str) -> list[str]:
    """Returns the violations in a page of playwright, whose policy must be off (``bypass_csp``)."""
    page.evaluate(axe)
    result = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [
        f"{label}: {violation['id']}: {node['html'][:200]}"
        for violation in result["violations"]
        for node in violation["nodes"][:3]
    ]


class Page(HTMLParser):
    """The elements and texts of a page; checks that every element is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open, self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((self._open[-1] if self._open else "", data.strip()))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def accessible_page(text: str) -> Page:
    """Returns the elements of a page without scripts; checks that a screen reader can read it, and
    that it loads nothing."""
    assert not re.search(r"(src|href|url|@import|<script|<link|<iframe)\b\s*[=(]?", text)
    page = Page(text)
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("main")) == 1
    headings = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h\d", tag)]
    assert headings[0] == 1
    assert headings.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(headings))
    ids = [str(a["id"]) for _, a in page.elements if "id" in a]
    assert len(ids) == len(set(ids))
    for tag, attributes in page.elements:
        for reference in str(attributes.get("aria-labelledby") or "").split():
            assert reference in ids, (tag, reference)
    for svg in page.all("svg"):
        assert svg["role"] == "img"
        assert svg["aria-labelledby"]
    assert all(attributes.get("scope") in ("row", "col") for attributes in page.all("th"))
    return page
