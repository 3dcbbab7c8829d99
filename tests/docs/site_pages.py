"""The pages of a built site: their links, their anchors and what they load."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADING = {("link", "href"), ("object", "data"), ("use", "href"), ("use", "xlink:href")}
"""Attributes that load a file, beside every ``src`` and ``srcset``."""


@dataclass
class SitePage(HTMLParser):
    path: Path
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=lambda: {"", "__skip"})

    def __post_init__(self) -> None:
        super().__init__()
        self.feed(self.path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        for name in ("id", "name"):
            if tag != "meta" and name in values:
                self.anchors.add(values[name])
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        for name, value in values.items():
            if name in ("src", "srcset") or (tag, name) in LOADING:
                self.loaded.append(value)


@functools.cache
def pages_of(site: Path) -> dict[Path, SitePage]:
    return {path: SitePage(path) for path in sorted(site.rglob("*.html"))}


def dead_links(site: Path) -> Iterator[str]:
    """Yields each link of a page that leads to no file, or to no anchor of a page."""
    pages = pages_of(site)
    for path, page in pages.items():
        if path.name == "404.html":  # its addresses begin at the root of the host
            continue
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target = target / "index.html"
            anchors = pages[target].anchors if target in pages else {unquote(parts.fragment)}
            is_robot = target.parent.name == "playground"  # the fragment is a robot file
            if not target.is_file() or not (is_robot or unquote(parts.fragment) in anchors):
                yield f"{path.relative_to(site)}: {link}"


def foreign_files(site: Path) -> Iterator[str]:
    """Yields each file that a page loads from another host."""
    for path, page in pages_of(site).items():
        for address in page.loaded:
            if urlsplit(address).netloc:
                yield f"{path.relative_to(site)}: {address}"
