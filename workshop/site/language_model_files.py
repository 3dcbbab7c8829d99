"""The files ``llms.txt`` and ``llms-full.txt`` of the site, by the convention of llmstxt.org.

``llms.txt`` lists the pages of the navigation with their first sentence, and leads to their text in
Markdown.  ``llms-full.txt`` is the text of all these pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

INDEX, FULL = "llms.txt", "llms-full.txt"
LONGEST = 160
"""Largest number of characters of the sentence about a page."""


class PageText(NamedTuple):
    """A page: section of the navigation, title, address of its Markdown on the site, text."""

    section: str
    title: str
    address: str
    text: str

    @property
    def sentence(self) -> str:
        """First sentence of the page, without links; may be empty."""
        blocks = re.split(r"\n\s*\n", re.sub(r"<!--.*?-->", "", self.text, flags=re.S))
        for block in map(str.strip, blocks):
            if block[:1].isalpha() or block.startswith(("`", "**")):
                plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split()))
                first = re.split(r"(?<=[.:])\s", plain, maxsplit=1)[0].rstrip(":")
                return first if len(first) <= LONGEST else first[: LONGEST - 4].rstrip() + " ..."
        return ""


def write_files(folder: Path, name: str, description: str, pages: Iterable[PageText]) -> None:
    """Writes both files, and the Markdown of each page, into the folder of the site."""
    index, full = [f"# {name}", "", f"> {description}"], [f"# {name}", "", description]
    section = None
    for page in pages:
        if page.section != section:
            section = page.section
            index += ["", f"## {section}", ""]
        end = f": {page.sentence}" if page.sentence else ""
        index.append(f"- [{page.title}]({page.address}){end}")
        full += ["", f"<!-- {page.address} -->", "", page.text.strip()]
        file = folder / page.address
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(page.text, encoding="utf-8")
    (folder / INDEX).write_text("\n".join(index) + "\n", encoding="utf-8")
    (folder / FULL).write_text("\n".join(full) + "\n", encoding="utf-8")
