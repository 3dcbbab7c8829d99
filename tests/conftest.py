from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from tests.workshop import Workshop

# The same examples on every machine, so that whoever has changed nothing sees nothing fail.
# New ones are looked for with HYPOTHESIS_PROFILE=default.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop(tmp_path)
