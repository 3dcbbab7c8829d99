"""Objects that a service tool overwrites while the robot drives, for both kinds of drives."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402, each_drive, roboteq
from tests.slow import mostly_slow, one_quick_of
from thorvaldc.model import Robot
from thorvaldc.model.bus_timing import (
    reading_time,
    required_objects,
    written_objects,
)
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.fault_injection import FaultInjector

both = each_drive("make")
Make = Callable[[], Robot]
NODE = "fl_controller"


def overwrite(rig: Rig, node: str, index: int, subindex: int, value: int) -> None:
    values = {"index": index, "subindex": subindex, "value": value}
    fault = BusFault("object_written", "main", node, 0.0, None, SPAN, **values)
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)


def limit(robot: Robot) -> float:
    """Longest time (s) until a change is a fault, with two cycles until the driver knows it."""
    bus = robot.buses[0]
    return reading_time(bus, bus.sync_period) + 2 * bus.sync_period


@pytest.mark.parametrize("node", mostly_slow(["fl_controller", "fr_controller"]))
@pytest.mark.parametrize(
    ("index", "subindex", "value"),
    one_quick_of(
        6,
        [
            (0x1015, 0, 9),
            (0x1016, 1, 0),
            (0x6007, 0, 0),
            (0x605A, 0, 0),
            (0x6084, 0, 1),
            (0x6085, 0, 1),
            (0x6884, 0, 1),
        ],
    ),
)
def test_a_change_that_nothing_else_shows(node: str, index: int, subindex: int, value: int) -> None:
    robot = cia402()
    model = next(n for n in robot.buses[0].nodes if n.name == node)
    expected = next(o for o in model.objects if (o.index, o.subindex) == (index, subindex))
    rig = Rig(robot)
    rig.drive(seconds=1.0)
    overwrite(rig, node, index, subindex, value)
    rig.until(lambda: rig.state is BaseState.FAULT, limit(robot))
    assert rig.reason == (
        f"{node}: {expected.name} ({index:#06x}:{subindex}) is {value}, "
        f"but must be {expected.value}"
    )


@both
def test_every_required_object_is_read_within_the_stated_time(make: Make) -> None:
    """The uploads of one round on the bus, and their order in time."""
    robot = make()
    rig = Rig(robot)
    rig.drive(seconds=1.0)
    begin = len(rig.frames)
    rig.run(reading_time(robot.buses[0], 0.02))
    uploads = [
        (t / 1e9, f.id - 0x600, int.from_bytes(f.data[1:3], "little"), f.data[3])
        for t, f in rig.frames[begin:]
        if 0x601 <= f.id <= 0x67F
    ]
    read = {(node, index, subindex) for _, node, index, subindex in uploads}
    assert read == {
        (controller.node.id, o.index, o.subindex)
        for controller in rig.base.state_machine.controllers
        for o in controller.expected_objects()
    }
    times = [time for time, *_ in uploads]
    assert min(b - a for a, b in itertools.pairwise(times)) > 0.015, "one in a cycle"


@both
@pytest.mark.parametrize("index", one_quick_of(3, [0x1400, 0x1401, 0x1600, 0x1800, 0x1A00, 0x1017]))
def test_a_changed_communication_object_is_a_fault(make: Make, index: int) -> None:
    """Another protection may be faster, such as that against missing reports."""
    robot = make()
    rig = Rig(robot)
    rig.drive(seconds=1.0)
    device = rig.simulated.devices[NODE]
    assert isinstance(device, CanopenDevice)
    subindex = 1 if index != 0x1017 else 0
    value = device.objects[index, subindex].value
    value = value | 1 << 31 if index & 0xFE00 in (0x1400, 0x1800) else value + 8
    overwrite(rig, NODE, index, subindex, value)
    rig.until(lambda: rig.state is BaseState.FAULT, limit(robot))
    assert NODE in rig.reason


@both
def test_nothing_is_found_while_nothing_changes(make: Make) -> None:
    rig = Rig(make())
    rig.drive(seconds=20.0)
    assert rig.state is BaseState.ACTIVE, rig.reason


@both
def test_an_object_that_is_wrong_at_the_start_up_is_a_fault(make: Make) -> None:
    rig = Rig(make(), power=False)
    rig.simulated.power_on()
    rig.simulated.run(0.3)
    overwrite(rig, NODE, 0x1400, 1, 0x80000201)
    rig.until(lambda: rig.state is BaseState.FAULT, 3.0)
    assert f"{NODE}: rpdo1_cob_id (0x1400:1) is 2147484161" in rig.reason


def test_the_objects_that_do_not_matter_to_a_script() -> None:
    """Its own program stops the motors; it has no objects of CiA 402."""
    rig = Rig(roboteq())
    rig.drive(seconds=1.0)
    overwrite(rig, NODE, 0x6085, 0, 1)
    overwrite(rig, NODE, 0x6060, 0, 1)
    rig.run(limit(rig.robot))
    assert rig.state is BaseState.ACTIVE, rig.reason
    overwrite(rig, NODE, 0x1016, 1, 5 << 16 | 100)
    rig.run(limit(rig.robot))
    assert rig.state is BaseState.ACTIVE, rig.reason


@pytest.mark.parametrize("example", SAMPLED_ROBOTS)
def test_the_table_of_the_page_has_every_object_and_the_driver_reads_what_the_flash_writes(
    example: str,
) -> None:
    rows = re.findall(
        r"^\| (0x\w{4})(?: to (0x\w{4}))? +\|",
        (Path(__file__).parents[3] / "docs/faults.md").read_text(encoding="utf-8"),
        re.M,
    )
    groups = [range(int(first, 16), int(last or first, 16) + 1) for first, last in rows]
    robot = example_robot(example)
    for bus in robot.buses:
        for node in bus.nodes:
            required = {(o.index, o.subindex) for o in required_objects(bus, node)}
            written = {(o.index, o.subindex) for o in written_objects(node)}
            commanded = {
                (index, subindex)
                for frame in bus.frames
                if node.name in frame.consumers
                for index, subindex, _ in frame.mapping
            }
            assert written - required <= commanded
            for index, subindex in required | written:
                assert any(index in group for group in groups), f"{index:#06x}:{subindex}"
