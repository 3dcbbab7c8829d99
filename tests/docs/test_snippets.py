"""The Python snippets of the pages and the examples of the docstrings run as they are shown.

The snippets of a page run in order, in one namespace and one process, in a folder that has:

- ``examples`` and ``modules`` of the repository,
- ``robot.yaml``, an example, and ``build/my_robot``, its build, where the page names them,
- each robot that the page shows as a complete YAML document, as ``<its name>.yaml``,
- each file that the page shows below a line ``File `NAME`:``.

A snippet below the comment ``<!-- not executed: REASON -->`` is left out.  The pages of the
diagnostic codes show mistakes and are left out too.
"""

from __future__ import annotations

import doctest
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.slow import mostly_slow

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    page
    for page in sorted(
        [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*/README.md")]
    )
    if "```python\n" in page.read_text(encoding="utf-8") and page.parent.name != "diagnostics"
]
BLOCK = re.compile(
    r"(?:^File `(?P<file>[^`]+)`:\n\n|^<!-- not executed: (?P<reason>[^\n]+) -->\n\n?)?"
    r"^```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^```$",
    re.M | re.S,
)
EXAMPLE = ROOT / "examples/4wd4ws_wide/robot.yaml"

# Compiled with the name of the page and its lines, a snippet has tracebacks that name the page.
RUNNER = """
import json, sys
namespace = {"__name__": "__main__"}
for page, line, text in json.load(sys.stdin):
    exec(compile("\\n" * line + text, page, "exec"), namespace)
"""


class Block(NamedTuple):
    """A code block of a page; ``line`` is the number of lines above its text."""

    language: str
    text: str
    line: int
    file: str
    reason: str


def blocks_of(page: str) -> list[Block]:
    return [
        Block(
            match["language"],
            match["text"],
            page.count("\n", 0, match.start("text")),
            match["file"] or "",
            match["reason"] or "",
        )
        for match in BLOCK.finditer(page)
    ]


def snippets_of(blocks: list[Block]) -> list[Block]:
    return [b for b in blocks if b.language == "python" and not b.file and not b.reason]


def write_files(folder: Path, text: str, blocks: list[Block]) -> None:
    """Writes the files that the snippets of a page need."""
    for name in ("examples", "modules"):
        # A page that writes files there gets a folder of its own, not that of the repository.
        if not any(block.file.startswith(f"{name}/") for block in blocks):
            (folder / name).symlink_to(ROOT / name)
    for block in blocks:
        name = re.match(r"thorvaldc: 1\n.*?^name: (\w+)", block.text, re.S | re.M)
        if block.file:
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "yaml" and name is not None and "\nmodules:" in block.text:
            (folder / f"{name[1]}.yaml").write_text(block.text, encoding="utf-8")
    robot = folder / "robot.yaml"
    snippets = "".join(b.text for b in snippets_of(blocks))
    if not robot.exists() and ("robot.yaml" in snippets or "build/my_robot" in snippets):
        robot.write_text(
            EXAMPLE.read_text(encoding="utf-8").replace("thorvald_4wd4ws_wide", "my_robot"),
            encoding="utf-8",
        )
    if "build/my_robot" in snippets:
        run([sys.executable, "-m", "thorvaldc", "build", "robot.yaml"], folder)


def run(command: list[str], folder: Path, text: str = "") -> str:
    process = subprocess.run(
        command,
        input=text,
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([*(p for p in sys.path if p), str(folder)]),
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    return process.stdout


@pytest.mark.parametrize(
    "page", mostly_slow(PAGES, 4), ids=lambda page: str(page.relative_to(ROOT))
)
def test_the_snippets_of_a_page_run(page: Path, tmp_path: Path) -> None:
    text = page.read_text(encoding="utf-8")
    blocks = blocks_of(text)
    write_files(tmp_path, text, blocks)
    name = str(page.relative_to(ROOT))
    snippets = [(name, block.line, block.text) for block in snippets_of(blocks)]
    if snippets:
        run([sys.executable, "-W", "error", "-c", RUNNER], tmp_path, json.dumps(snippets))


def test_every_snippet_is_a_block_that_is_recognised() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        recognised = [block for block in blocks_of(text) if block.language == "python"]
        assert len(recognised) == len(re.findall(r"^ *```python", text, re.M)), page


def test_the_runner_reports_the_page_and_the_line(tmp_path: Path) -> None:
    (block,) = snippets_of(blocks_of("# Title\n\n```python\na = 1\nb = c\n```\n"))
    with pytest.raises(AssertionError, match=r'File "page.md", line 5.*\n.*NameError|NameError'):
        run(
            [sys.executable, "-c", RUNNER],
            tmp_path,
            json.dumps([("page.md", block.line, block.text)]),
        )


DOCTESTED = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in ROOT.glob("thorvaldc/**/*.py")
    if "    >>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("module", DOCTESTED)
def test_the_examples_of_the_docstrings_are_true(
    module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(importlib.import_module(module.removesuffix(".__init__")))
    assert result.attempted > 0
    assert result.failed == 0
