"""What the status of an installed robot says of its computer."""

from __future__ import annotations

import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Command
from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.runtime.test_status_page import Site
from tests.simulation.bus.robots import CIA402, compiled
from tests.tools.computer.conftest import Programs
from thorvaldc.runtime.control_channel import ControlServer
from thorvaldc.runtime.service_table import Services
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


def test_a_driver_of_another_version(
    root: Path, thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    thorvaldc("install", "good.yaml", "--root", str(root))
    (root / "run/thorvaldc/good").mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="tv") as folder:  # the path of a socket is short
        Path(folder, "r").symlink_to(root)
        monkeypatch.chdir(folder)
        server = ControlServer(f"{folder}/r/run/thorvaldc/good/control", Services([]))
        ended = threading.Event()

        def serve() -> None:
            while not ended.wait(0.01):
                server.poll(time.monotonic())

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            status = robot_status(Computer(Path("r")), "good", is_live=False)
        finally:
            ended.set()
            thread.join()
            server.close()
    assert status["driver"] is None
    assert "is thorvaldc older than" in status_lines(status)[-1]
    assert "restart the service" in status_lines(status)[-1]


@pytest.mark.slow
def test_a_fault_with_its_page(
    root: Path, thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    thorvaldc("install", "good.yaml", "--root", str(root))
    (root / "run/thorvaldc/good").mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="tv") as folder:  # the path of a socket is short
        Path(folder, "r").symlink_to(root)
        monkeypatch.chdir(folder)
        site = Site(compiled(CIA402), f"{folder}/r/run/thorvaldc/good/control")

        device = site.simulated.devices["fl_controller"]
        site.simulated.timeline.after(12_000_000_000, device.power_off)

        def look(site: Site) -> tuple[list[str], dict[str, Any], Any]:
            site.until(lambda: bool(site.state()["fault"]))
            status = robot_status(Computer(Path("r")), "good", is_live=False)
            return status_lines(status), status["driver"], site.request("GET", "/state").json

        lines, driver, shown = site.while_it_runs(look, drives=False)
    fault = next(line for line in lines if line.startswith("  FAULT: "))
    assert "no tpdo1 for" in fault
    assert fault.endswith("(TV880 bus-stopped, see `thorvaldc explain TV880`)")
    assert driver["fault_code"] == shown["code"] == "TV880"
