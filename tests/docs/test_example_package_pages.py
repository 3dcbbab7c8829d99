"""The code blocks of the pages about example packages are parts of their files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import pytest

from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryDriver
from thorvaldc.runtime.can_base.motor_controller import MotorController

ROOT = Path(__file__).resolve().parents[2]


class Page(NamedTuple):
    """A page, the example that it walks through, and the base class of the driver."""

    path: str
    package: str
    driver: type[MotorController] | type[BatteryDriver]

    @property
    def text(self) -> str:
        return (ROOT / "docs" / self.path).read_text(encoding="utf-8")

    def files(self, language: str) -> list[str]:
        """Returns the texts of the files of the package in a language."""
        suffixes = {"yaml": "module.yaml", "python": "*.py", "toml": "pyproject.toml"}
        files = sorted((ROOT / "examples" / self.package).rglob(suffixes[language]))
        return [file.read_text(encoding="utf-8") for file in files]


PAGES = [
    Page("motor-controllers.md", "odrive", MotorController),
    Page("batteries.md", "jk_bms", BatteryDriver),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.package)
def test_the_code_blocks_are_parts_of_the_files(page: Page) -> None:
    blocks = re.findall(r"```(yaml|python|toml)\n(.*?)```", page.text, re.S)
    assert {language for language, _ in blocks} == {"yaml", "python", "toml"}
    for language, block in blocks:
        assert any(block in text for text in page.files(language)), block


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.package)
def test_the_page_names_every_method_of_the_driver(page: Page) -> None:
    for name in page.driver.__abstractmethods__:
        assert f"`{name}`" in page.text, name
