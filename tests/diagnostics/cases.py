"""Reads the cases of the diagnostic codes from their pages in ``docs/diagnostics``.

A case is a comment ``<!-- case -->`` and the code blocks ``diff`` below it.  Cases that no reader
needs are inside of the comment.  A block is a file: robot.yaml, or that of its ``title``.  Lines
that begin with ``-`` raise the diagnostic, those with ``+`` stand in their place in the good files,
which do not raise it.  The comment has keys:

- ``base``: the files that the blocks change: a key of bases.yaml, or ``above``, the good files of
  the first case of the page, whose other keys are then the defaults.  A block replaces its good
  lines, if they are in that file once; else its keys are added, and replace equal ones;
- ``at``: text in the line of the diagnostic (default: the first line ``-``), number of the line, or
  ``nowhere`` if the diagnostic has no span; ``file``: its file (default: any);
- ``files``: files that no block can show: ``!!binary``, or ``{repeat: text, times: n}``;
  ``good``: the same of the good files, where they differ;
- ``entry``: the file to compile (default ``robot.yaml``);
- ``run`` and its arguments: the command to test, see ``test_cases``;
- ``good_<key>``: value of a key for the good files, such as ``good_twist``.

``U+00A0`` in a block is the character with this number.
"""

from __future__ import annotations

import contextlib
import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).parent
PAGES = HERE.parent.parent / "docs" / "diagnostics"
BASES: dict[str, dict[str, str]] = yaml.safe_load((HERE / "bases.yaml").read_text("utf-8"))
GOOD = "good_"
_CASE = re.compile(
    r"^<!-- case(?P<keys>[^\n]*?)(?: -->)?\n(?P<blocks>(?:```diff[^\n]*\n.*?^```\n)*)", re.M | re.S
)
_BLOCK = re.compile(r'```diff(?: title="(.*?)")?\n(.*?)^```\n', re.M | re.S)


@functools.cache
def read_cases(page: Path) -> list[dict[str, Any]]:
    """Returns the cases of a page: ``files``, ``good`` and the keys of the comment."""
    text = page.read_text(encoding="utf-8")
    cases: list[dict[str, Any]] = []
    for match in _CASE.finditer(text):
        keys = yaml.safe_load("{" + match["keys"] + "}")
        base = keys.pop("base", None)
        first = cases[0] if base == "above" else {"good": BASES[base] if base else {}}
        blocks = {
            title or "robot.yaml": re.sub(r"U\+(\w{4})", lambda c: chr(int(c[1], 16)), lines)
            for title, lines in _BLOCK.findall(match["blocks"])
        }
        case = {k: v for k, v in first.items() if k not in ("at", "file")} | keys
        case["files"] = dict(first["good"])
        case["good"] = {**keys.get("files", {}), **first["good"]}
        for file, block in blocks.items():
            bad, good = changed(first["good"].get(file), block.split("\n")[:-1])
            case["files"] |= {file: bad} if bad else {}
            case["good"] |= {file: good} if good else {}
        case["files"] |= keys.get("files", {})
        case["good"] |= keys.get("good", {})
        if "at" not in case:
            case["file"], case["at"] = next(
                (file, line[1:])
                for file, block in blocks.items()
                for line in block.split("\n")
                if line.startswith("-")
            )
        cases.append({k: v for k, v in case.items() if v is not None})
    return cases


def changed(base: str | None, block: Sequence[str]) -> tuple[str, str]:
    """Returns the bad and the good text of a block, as changes of ``base``."""
    bad = [f"{line[1:]}\n" for line in block if not line.startswith("+")]
    good = [f"{line[1:]}\n" for line in block if not line.startswith("-")]
    if base is None:
        return "".join(bad), "".join(good)
    lines = base.splitlines(keepends=True)
    starts = [i for i in range(len(lines)) if good and lines[i : i + len(good)] == good]
    if len(starts) == 1:
        lines[starts[0] : starts[0] + len(good)] = bad
        return "".join(lines), base
    return "".join(_merged(lines, bad)), "".join(_merged(lines, good))


def _merged(lines: list[str], part: list[str], indent: int = 0) -> list[str]:
    """Returns the lines of a mapping with those of another one, at all levels."""
    entries = _entries(lines, indent)
    for key, entry in _entries(part, indent).items():
        old = entries.get(key, [])
        if entry[:1] == old[:1] and len(entry) > 1 and len(old) > 1:
            with contextlib.suppress(ValueError):  # a list is replaced
                entry = [entry[0], *_merged(old[1:], entry[1:], indent + 2)]
        entries[key] = entry
    return [line for entry in entries.values() for line in entry]


def _entries(lines: list[str], indent: int) -> dict[str, list[str]]:
    """Returns the lines of each key.  Raises ``ValueError`` if the lines are no mapping."""
    entries: dict[str, list[str]] = {}
    entry: list[str] | None = None
    for line in lines:
        if match := re.match(rf' {{{indent}}}("[^"]*"|[\w.]+|<<):', line):
            entry = entries.setdefault(match[1], [])
        elif entry is None or (line.strip() and not line.startswith((" " * (indent + 1), "#"))):
            raise ValueError(line)
        entry.append(line)
    return entries
