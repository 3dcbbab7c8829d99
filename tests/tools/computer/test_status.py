"""What the status of an installed robot says of its computer."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import Rig
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


def test_the_load_of_each_bus(root: Path, thorvaldc: Command) -> None:
    thorvaldc("install", "good.yaml", "--root", str(root))
    status = robot_status(Computer(root), "good", is_live=False)
    rig = Rig(example_robot("4wd4ws_wide"))
    rig.ready()
    rig.run(2.0)
    status["driver"] = rig.driven.state()
    (load,) = status["driver"]["bus_load"].values()
    assert load > 0.05
    (line,) = (line for line in status_lines(status) if line.startswith("  bus "))
    assert line == f"  bus main: at most {100.0 * load:.0f} % of its bit rate in use"


def test_a_driver_of_another_user(
    root: Path, thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    thorvaldc("install", "good.yaml", "--root", str(root))
    channel = root / "run/thorvaldc/good/control"
    channel.parent.mkdir(parents=True)
    channel.touch()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everything
    assert "only root and the user" in thorvaldc("status", "--root", str(root)).out
