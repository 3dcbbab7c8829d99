"""What the status of an installed robot says of its computer."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.tools.computer.conftest import Programs
from thorvaldc.tools.computer.installed_versions import Computer
from thorvaldc.tools.computer.robot_status import robot_status, status_lines


@pytest.mark.parametrize(
    ("timedatectl", "line"),
    [
        ("echo yes", "  clock: synchronised"),
        ("echo no", "  clock: NOT synchronised"),
        ("exit 1", "  clock: unknown synchronisation"),
    ],
)
def test_the_clock(
    root: Path, thorvaldc: Command, programs: Programs, timedatectl: str, line: str
) -> None:
    if Path("/run/systemd/timesync").is_dir():
        pytest.skip("systemd-timesyncd answers on this computer")
    thorvaldc("install", "good.yaml", "--root", str(root))
    programs(systemctl="echo ActiveState=failed", timedatectl=timedatectl)
    lines = status_lines(robot_status(Computer(root), "good", is_live=True))
    assert line in lines


def test_a_driver_of_another_user(
    root: Path, thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    thorvaldc("install", "good.yaml", "--root", str(root))
    channel = root / "run/thorvaldc/good/control"
    channel.parent.mkdir(parents=True)
    channel.touch()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everything
    assert "only root and the user" in thorvaldc("status", "--root", str(root)).out
