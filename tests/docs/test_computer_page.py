"""The page of the tutorial about a robot's computer, on a computer with systemd."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.container import in_container


@pytest.mark.slow
@pytest.mark.xdist_group("container")
@pytest.mark.timeout(900)
def test_every_command_prints_what_the_page_shows(tmp_path: Path) -> None:
    record = in_container("tests.docs.computer_session", tmp_path)
    assert not record["differences"], "\n\n".join(record["differences"])
