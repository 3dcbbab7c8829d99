"""LSS gives node ids only to devices whose type fits the robot file."""

from __future__ import annotations

import dataclasses

import pytest

from tests.commissioning.bench import QUICK, SWAPPED, Bench, four_drives
from tests.commissioning.robots import without_serials
from tests.commissioning.test_flash import writes
from thorvaldc.commissioning.bus_configuration import configuration_of
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Robot

LSS_DRIVE = "rr_controller"


def of_type(robot: Robot, device_type: int | None, **identity: None) -> Robot:
    """Returns the robot with another type (object 0x1000) of the drive in its file."""
    bus = robot.buses[0]
    nodes = tuple(
        dataclasses.replace(node, device_type=device_type, **identity)
        if node.name == LSS_DRIVE
        else node
        for node in bus.nodes
    )
    return dataclasses.replace(robot, buses=(dataclasses.replace(bus, nodes=nodes),))


@pytest.mark.parametrize("node_id", [20, 4])
def test_lss_moves_no_device_of_another_type(node_id: int) -> None:
    """The serial number fits; the type of the device is read at the id that it has."""
    bench = Bench(four_drives(), {LSS_DRIVE: {"node_id": node_id}}, timing=QUICK)
    robot = of_type(four_drives(), 0x191)
    bench.configuration = configuration_of(robot, robot.buses[0])
    plan = bench.plan()
    assert any("its device type is" in text and "not 0x191" in text for text in plan.problems)
    count = writes(bench)
    with pytest.raises(DiagnosticError, match="not 0x191"):
        bench.apply()
    assert bench.devices()[LSS_DRIVE].node_id == node_id
    assert count() == 0


def test_lss_takes_the_id_from_a_device_of_another_type() -> None:
    """A device without an id cannot be asked for its type before it has one."""
    bench = Bench(four_drives(), {LSS_DRIVE: {"node_id": 255}}, timing=QUICK)
    robot = of_type(four_drives(), 0x191)
    bench.configuration = configuration_of(robot, robot.buses[0])
    assert not bench.plan().problems
    with pytest.raises(DiagnosticError, match="not 0x191; it gets no id"):
        bench.apply()
    bench.simulated.run(1.0)
    assert bench.devices()[LSS_DRIVE].node_id == 255
    assert not bench.watch.doubles


def test_lss_needs_vendor_and_product() -> None:
    """Without them, the identity of any device would fit."""
    bench = Bench(without_serials(four_drives(), [LSS_DRIVE]), SWAPPED, timing=QUICK)
    robot = of_type(bench.robot, None, vendor_id=None, product_code=None)
    bench.configuration = configuration_of(robot, robot.buses[0])
    assert any("states no vendor_id and product_code" in text for text in bench.plan().problems)
