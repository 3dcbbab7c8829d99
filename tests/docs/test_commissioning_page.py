"""The steps of docs/commissioning.md on a simulated bus print what the page shows."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

from tests.docs.tutorial import Reader, programs_in
from tests.ros.environments import variables

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_steps_without_hardware(tmp_path: Path) -> None:
    page = (ROOT / "docs/commissioning.md").read_text(encoding="utf-8")
    section = re.search(r"^## Try it without hardware\n.*?(?=^## )", page, re.M | re.S)
    assert section is not None
    shutil.copytree(ROOT / "examples/lss", tmp_path / "lss")
    path = f"{programs_in(tmp_path / 'bin')}{os.pathsep}{os.environ['PATH']}"
    environment = {
        **variables(tmp_path),
        "PATH": path,
        "PYTHONPATH": str(ROOT),
        "XDG_RUNTIME_DIR": str(tmp_path),
    }
    differences = Reader(tmp_path / "lss", environment).follow_in_real_time(section[0])
    assert not differences, "\n\n".join(differences)
