"""Drivers that other packages offer by entry points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import metadata

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.runtime.can_base.test_can_base import four_wheels
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base import battery_and_io_drivers as devices
from thorvaldc.runtime.can_base import motor_controller as controller
from thorvaldc.runtime.can_base.battery_and_io_drivers import KcBatteryDriver
from thorvaldc.runtime.can_base.roboteq_driver import RoboteqScriptController
from thorvaldc.simulation.bus.simulated_robot import SIMULATED_DEVICES


class Mine(RoboteqScriptController):
    """Another package's driver, with the same protocol as the Roboteq script."""


class MyBattery(KcBatteryDriver):
    @property
    def warning(self) -> str:
        return "mine"


@dataclass
class Entry:
    name: str
    loaded: object
    value: str = "mine:Mine"

    def load(self) -> object:
        if isinstance(self.loaded, Exception):
            raise self.loaded
        return self.loaded


def offer(monkeypatch: pytest.MonkeyPatch, group: str, *entries: Entry) -> None:
    real_entry_points = metadata.entry_points

    def entry_points(**given: str) -> object:
        return list(entries) if given.get("group") == group else real_entry_points(**given)

    monkeypatch.setattr(metadata, "entry_points", entry_points)


def renamed(robot: Robot, node: str, protocol: str) -> Robot:
    """Returns the robot with another protocol for a node; the simulated device stays the same."""
    bus = robot.buses[0]
    before = next(n.protocol for n in bus.nodes if n.name == node)
    nodes = tuple(replace(n, protocol=protocol) if n.name == node else n for n in bus.nodes)
    builtin = SIMULATED_DEVICES.builtin
    builtin.setdefault(protocol, builtin[before])
    return replace(robot, buses=(replace(bus, nodes=nodes),))


def test_a_robot_drives_by_a_motor_controller_of_another_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    offer(monkeypatch, controller.PLUGINS.group, Entry("acme_servo", Mine))
    monkeypatch.setattr(SIMULATED_DEVICES, "builtin", dict(SIMULATED_DEVICES.builtin))
    rig = Rig(renamed(four_wheels(), "fl_controller", "acme_servo"))
    kinds = [type(c) for c in rig.base.state_machine.controllers]
    assert kinds.count(Mine) == 1
    rig.drive()


def test_a_battery_of_another_package(monkeypatch: pytest.MonkeyPatch) -> None:
    offer(monkeypatch, devices.PLUGINS.group, Entry("acme_battery", MyBattery))
    monkeypatch.setattr(SIMULATED_DEVICES, "builtin", dict(SIMULATED_DEVICES.builtin))
    robot = four_wheels()
    name = robot.batteries[0].node
    assert name is not None
    rig = Rig(renamed(robot, name, "acme_battery"))
    rig.ready()
    assert rig.base.warnings(rig.now) == [f"{name}: mine"]


@pytest.mark.parametrize(
    ("loaded", "reason"),
    [
        (ImportError("no acme"), "cannot be loaded: no acme"),
        (KcBatteryDriver, "is no MotorController"),
        (object(), "is no MotorController"),
    ],
)
def test_a_driver_that_cannot_be_used(
    loaded: object, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(monkeypatch, controller.PLUGINS.group, Entry("acme_servo", loaded))
    monkeypatch.setattr(SIMULATED_DEVICES, "builtin", dict(SIMULATED_DEVICES.builtin))
    with pytest.raises(DiagnosticError) as caught:
        Rig(renamed(four_wheels(), "fl_controller", "acme_servo"))
    assert caught.value.diagnostic.code.name == "bus-driver-unknown"
    assert reason in caught.value.diagnostic.message
