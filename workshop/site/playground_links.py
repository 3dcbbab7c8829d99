"""Links from the robot files in the pages to the playground, which opens them."""

from __future__ import annotations

import base64
import json
import re
import shutil
import tempfile
import zlib
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file

BLOCK = re.compile(r"^```yaml[^\n]*\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
PLACEHOLDER = re.compile(r"<[a-z_]+>|\.\.\.")
OTHER_FILES = re.compile(r"^(library|extras|robots|fleet|calibration):", re.MULTILINE)


def can_build() -> bool:
    """Returns whether this computer can build the playground."""
    return shutil.which("npm") is not None


def with_links(markdown: str, playground: str) -> str:
    """Adds a link below each robot file in a page.

    - ``playground``: address of the playground, relative to the page.
    """

    def linked(block: re.Match[str]) -> str:
        if not is_robot(block[1]):
            return block[0]
        address = f"{playground}#{fragment(block[1])}"
        link = f'<a class="open-playground" href="{address}">open in the playground</a>'
        return f"{block[0]}\n{link}\n"

    return BLOCK.sub(linked, markdown)


def without_links(markdown: str) -> str:
    """Replaces links to the playground of the site, which lacks it, by their text."""
    return re.sub(r'<a href="[^"]*playground/index\.html[^"]*">(.*?)</a>', r"\1", markdown)


def with_example_link(markdown: str, example: Path, playground: str) -> str:
    """Adds a link below the title of the page of an example, if the playground has the example.

    - ``example``: folder of the example.
    """
    if not any((example / name).is_file() for name in ("robot.yaml", "fleet.yaml")):
        return markdown
    title, newline, text = markdown.partition("\n")
    address = f"{playground}#example={example.name}"
    link = f'<a class="open-playground" href="{address}">open in the playground</a>'
    return f"{title}{newline}\n{link}\n{text}"


def is_robot(text: str) -> bool:
    """Returns whether a text is a whole robot file that needs no other file.

    It may have errors, which a page explains, but none that leaves nothing of the robot.
    """
    has_keys = all(f"\n{key}:" in f"\n{text}" for key in ("thorvaldc", "name", "modules"))
    if not has_keys or PLACEHOLDER.search(text) or OTHER_FILES.search(text):
        return False
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.yaml")
        path.write_text(text, encoding="utf-8")
        compilation = compile_file(path)
        missing = (d.code.name for d in compilation.report.errors)
        return compilation.model is not None or "module-unknown" not in missing


def fragment(text: str) -> str:
    """Returns the fragment of a link to a robot file, as the page writes it (`host.js`)."""
    files = json.dumps({"main": "robot.yaml", "files": {"robot.yaml": text}})
    packer = zlib.compressobj(9, wbits=-15)
    packed = packer.compress(files.encode()) + packer.flush()
    return f"robot={base64.urlsafe_b64encode(packed).decode().rstrip('=')}"
