"""The code blocks of docs/motor-controllers.md are parts of the example package."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "motor-controllers.md"
FILES = {
    "yaml": "modules/controller/odrive/module.yaml",
    "python": "thorvaldc_odrive/driver.py",
    "toml": "pyproject.toml",
}


def test_the_code_blocks_are_parts_of_the_files() -> None:
    blocks = re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    compared = [language for language, _ in blocks if language in FILES]
    assert set(compared) == set(FILES)
    for language, block in blocks:
        if language in FILES:
            text = (ROOT / "examples" / "odrive" / FILES[language]).read_text(encoding="utf-8")
            assert block in text, block


def test_the_page_names_every_method_of_the_driver() -> None:
    from thorvaldc.runtime.can_base.motor_controller import MotorController

    text = PAGE.read_text(encoding="utf-8")
    for name in MotorController.__abstractmethods__:
        assert f"`{name}`" in text, name
