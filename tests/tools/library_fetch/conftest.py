"""A repository with a library of modules, and a robot that uses it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.outside_tools import require
from tests.repository import commit_all, git

PLATE = """\
thorvaldc: 1
description: A plate of the vendor.
mount: {kinds: [frame_clamp], link: body}
links:
  body:
    parts:
      - {shape: {box: [0.2, 0.2, 0.02]}, mass: MASS kg, source: "estimated: a plate"}
"""
NAME = "modules/top/plate/module.yaml"
PART = "  plate: {type: top/plate, mount: {parent: frame, xyz: [0, 0, 146 mm]}}\n"


def plate(mass: float = 2.0) -> str:
    return PLATE.replace("MASS", str(mass))


class Vendor:
    """The repository ``vendor`` with the tag v1.2, and robot.yaml, which names it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "vendor"
        self.url = self.folder.as_uri()
        self.cache = folder / "cache"
        self.release("v1.2", 2.0)
        self.robot(f'{{git: "{self.url}", tag: v1.2, folder: modules}}')

    def release(self, tag: str, mass: float) -> None:
        path = self.folder / NAME
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(plate(mass), encoding="utf-8")
        self.commit(tag)

    def commit(self, tag: str) -> None:
        commit_all(self.folder)
        git(self.folder, "tag", "--force", tag)

    def robot(self, library: str) -> None:
        Path("robot.yaml").write_text(f"library: [{library}]\n{GOOD}{PART}", encoding="utf-8")

    def cached(self) -> list[Path]:
        """The files of the cache."""
        return sorted(path for path in self.cache.rglob("*") if path.is_file())


@pytest.fixture
def vendor(thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Vendor:
    require("git")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    return Vendor(tmp_path)
