"""The values of `bus.yml` reach a node, written in their order or by the tool `dcfgen`."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.backend_files import files_of
from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.outside_tools import path_of_dcfgen
from tests.simulation.bus.master import Master
from tests.simulation.bus.robots import cia402_robot, uneven_robot
from tests.slow import mostly_slow
from thorvaldc.backends.can import Can
from thorvaldc.model import Node, Robot
from thorvaldc.model.bus import OBJECT_TYPES
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot


def required_values(node: Node) -> dict[tuple[int, int], bytes]:
    """Returns the data bytes of all values that the node must have."""
    return {
        (entry.index, entry.subindex): (entry.value & (1 << 64) - 1).to_bytes(8, "little")[
            : OBJECT_TYPES[entry.type][1] // 8
        ]
        for entry in node.objects
        if entry.access == "rw" and entry.value is not None
    }


@pytest.mark.parametrize(("name", "number"), [("cia402", 72), ("4wd4ws_wide", 46)])
def test_the_values_in_their_order_configure_a_new_drive(name: str, number: int) -> None:
    """The simulated drive refuses a mapping that is written in another order."""
    robot = cia402_robot() if name == "cia402" else example_robot(name)
    node = robot.buses[0].nodes[0]
    required = required_values(node)
    assert len(required) == number
    bus = yaml.safe_load(files_of(Can, robot)["can/bus.yml"])
    simulated = SimulatedRobot(robot, delivered=True, nonvolatile={node.name: {"node_id": node.id}})
    simulated.devices[node.name].power_on()
    master = Master(simulated.interface())
    simulated.run(0.2)
    for download in bus["nodes"][node.name]["sdo"]:
        key = download["index"], download["sub_index"]
        master.write(node.id, *key, download["value"], len(required[key]))
    for key, data in required.items():
        assert master.read(node.id, *key) == data, key


def concise_dcf(data: bytes) -> dict[tuple[int, int], bytes]:
    """Returns the last data of each object in a binary DCF (CiA 302-3, object 0x1F22)."""
    (count,) = struct.unpack_from("<I", data)
    position, values = 4, {}
    for _ in range(count):
        index, subindex, size = struct.unpack_from("<HBI", data, position)
        values[index, subindex] = data[position + 7 : position + 7 + size]
        position += 7 + size
    assert position == len(data)
    return values


@pytest.mark.parametrize("name", mostly_slow(["cia402", *SAMPLED_ROBOTS], 2))
def test_dcfgen_writes_all_values(name: str, tmp_path: Path) -> None:
    """With the rearranged file that the tool `cogen` of ros2_canopen passes to `dcfgen`."""
    dcfgen = path_of_dcfgen()
    robot: Robot = cia402_robot() if name == "cia402" else example_robot(name)
    for path, content in files_of(Can, robot).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    for bus in robot.buses:
        path = "bus.yml" if len(robot.buses) == 1 else f"{bus.name}.bus.yml"
        if not (tmp_path / "can" / path).exists():
            continue
        config: dict[str, Any] = yaml.safe_load((tmp_path / "can" / path).read_text())
        config |= config.pop("nodes")
        (tmp_path / "can/expanded.yml").write_text(yaml.safe_dump(config))
        subprocess.run([dcfgen, "-d", ".", "-rS", "expanded.yml"], cwd=tmp_path / "can", check=True)
        assert (tmp_path / "can/master.dcf").exists()
        for node in bus.nodes:
            if required := required_values(node):
                written = concise_dcf((tmp_path / "can" / f"{node.name}.bin").read_bytes())
                assert written == required, node.name


def test_the_axes_of_a_drive_are_in_the_order_of_its_motors() -> None:
    robot = uneven_robot()
    bus = yaml.safe_load(files_of(Can, robot)["can/bus.yml"])
    orders = set()
    for node in robot.buses[0].nodes:
        if not node.is_cia402:
            continue
        entry = bus.get(node.name) or bus["nodes"][node.name]
        # A module may list the channel of the second motor first.
        order = [name for _, name in sorted(motors_of(node))]
        assert entry["channel_names"] == [f"{node.name}_{name}" for name in order]
        for name, axis in zip(order, entry["channels"], strict=True):
            quantity = "pos" if name == "steering" else "vel"
            assert f"scale_{quantity}_to_dev" in axis, (node.name, name)
        orders.add((order[0], node.channels[0].name))
    assert orders == {("steering", "steering"), ("propulsion", "steering")}


def motors_of(node: Node) -> list[tuple[int, str]]:
    """The first object index and the name of each channel, by the names of the objects."""
    return [
        (min(o.index for o in node.objects if o.name.startswith(f"{c.name}_")), c.name)
        for c in node.channels
    ]
