"""The robot of the studies."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import UNPOWERED


@pytest.fixture(autouse=True)
def _unpowered(request: pytest.FixtureRequest) -> None:
    """The studies vary the good robot without its battery, whose mass is symmetrical."""
    for command in {"thorvaldc", "run"} & set(request.fixturenames):
        request.getfixturevalue(command)
        Path("good.yaml").write_text(UNPOWERED, encoding="utf-8")
