"""A motor controller of another package: driver, simulated device and module type."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from tests.examples import FOLDER
from tests.runtime.can_base.simulated_rig import Rig
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.simulation.bus.battery_and_io_devices import ForeignDevice
from thorvaldc.simulation.bus.simulated_robot import SIMULATED_DEVICES, SimulatedRobot

ACME = Path(__file__).with_name("acme")
"""A package for a CANopen controller, which docs/simulated-bus.md names as an example."""
ENTRY_POINTS = """
[thorvaldc.motor_controllers]
acme_servo = acme.driver:AcmeServoController

[thorvaldc.simulated_devices]
acme_servo = acme.simulated:AcmeServo
"""


def install(folder: Path, entry_points: str) -> None:
    """Writes the package ``acme`` as an installed one."""
    package = folder / "acme"
    package.mkdir()
    for name in ("__init__.py", "driver.py", "simulated.py"):
        shutil.copyfile(ACME / name, package / name)
    info = folder / "acme-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1\n")
    (info / "entry_points.txt").write_text(entry_points)


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the installed package."""
    install(tmp_path, ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(tmp_path))
    for module in ("acme", "acme.driver", "acme.simulated"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    return tmp_path


def robot_with_acme_servo(folder: Path) -> Robot:
    module = folder / "modules" / "controller" / "acme_servo"
    module.mkdir(parents=True)
    shutil.copyfile(ACME / "module.yaml", module / "module.yaml")
    text = (FOLDER / "2wd0ws_greenhouse" / "robot.yaml").read_text(encoding="utf-8")
    robot_file = folder / "robot.yaml"
    robot_file.write_text(text.replace("controller/propulsion_propulsion", "controller/acme_servo"))
    compilation = compile_file(robot_file, library=[folder / "modules"])
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


def test_a_robot_drives_with_driver_and_simulated_device_of_a_package(acme: Path) -> None:
    rig = Rig(robot_with_acme_servo(acme))
    assert type(rig.simulated.devices["controller"]).__name__ == "AcmeServo"
    assert type(rig.base.state_machine.controllers[0]).__name__ == "AcmeServoController"
    rig.drive()
    assert rig.speed() == pytest.approx(0.5, abs=0.01)
    rig.simulated.run(1.0)  # the driver hangs: no commands
    assert rig.speed() == 0.0, "the device brakes without commands"


def test_a_protocol_without_simulated_device_only_sends_its_frames(
    acme: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SIMULATED_DEVICES, "group", "another.group")
    simulated = SimulatedRobot(robot_with_acme_servo(acme))
    assert type(simulated.devices["controller"]) is ForeignDevice


def test_a_simulated_device_that_cannot_be_used(tmp_path: Path, acme: Path) -> None:
    info = tmp_path / "acme-1.dist-info" / "entry_points.txt"
    info.write_text(info.read_text().replace("AcmeServo\n", "struct\n"))
    with pytest.raises(DiagnosticError) as error:
        SimulatedRobot(robot_with_acme_servo(acme))
    diagnostic = error.value.diagnostic
    assert diagnostic.code.name == "bus-driver-unknown"
    assert diagnostic.message == "the simulated device for `acme_servo` is no SimulatedDevice"
