"""Independent libraries (canopen, cantools) read the generated files and the simulated bus."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canopen
import cantools
import pytest

from tests.backend_files import dbc_message, dbc_of, files_of
from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402_robot, uneven_robot
from tests.slow import mostly_slow
from thorvaldc.backends.can import Can
from thorvaldc.model import Node, Robot
from thorvaldc.model.bus import OBJECT_TYPES
from thorvaldc.runtime.can_base.signal_codec import FrameCodec
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus import python_can_plugin as interface
from thorvaldc.simulation.bus.bus_server import serving
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

NAMES = [*SAMPLED_ROBOTS, "cia402"]


@pytest.fixture(scope="module", params=NAMES)
def robot(request: pytest.FixtureRequest) -> Robot:
    return cia402_robot() if request.param == "cia402" else example_robot(request.param)


@pytest.fixture(scope="module")
def files(robot: Robot) -> dict[str, bytes]:
    return files_of(Can, robot)


def dictionary(files: dict[str, bytes], node: Node, folder: Path) -> Any:
    path = folder / f"{node.name}.dcf"
    path.write_bytes(files[f"can/dcf/{node.name}.dcf"])
    return canopen.objectdictionary.import_od(str(path))


def nodes(robot: Robot) -> Iterator[Node]:
    """Yields the CANopen nodes: those with objects."""
    return (node for bus in robot.buses for node in bus.nodes if node.objects)


# -- canopen -------------------------------------------------------------------------------------


def test_canopen_imports_each_dcf(robot: Robot, files: dict[str, bytes], tmp_path: Path) -> None:
    dcf_paths = sorted(path for path in files if path.startswith("can/dcf/"))
    assert dcf_paths == sorted(f"can/dcf/{node.name}.dcf" for node in nodes(robot))
    for node in nodes(robot):
        od = dictionary(files, node, tmp_path)
        assert od.node_id == node.id
        assert od.bitrate == robot.buses[0].bitrate
        for entry in node.objects:
            entry_in_od = od[entry.index]
            if not isinstance(entry_in_od, canopen.objectdictionary.ODVariable):
                entry_in_od = entry_in_od[entry.subindex]
            if entry.value is not None:
                assert entry.value in (entry_in_od.value, entry_in_od.default), entry.name


def test_canopen_reads_the_values_of_the_dcfs_from_running_nodes(
    robot: Robot, files: dict[str, bytes], tmp_path: Path
) -> None:
    """The SDO client of canopen, with the DCF that it has imported, reads a simulated node."""
    interface.register()
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    simulated.run(0.3)  # all nodes have booted
    channel = str(tmp_path / "bus.sock")
    listed = list(nodes(robot))
    if not listed:
        return  # a bus without CANopen nodes
    with serving(simulated.timeline, {channel: simulated.wire()}), canopen.Network() as network:
        network.connect(interface="thorvaldc_sim", channel=channel)
        for node in (listed[0], listed[-1]):
            remote = network.add_node(node.id, dictionary(files, node, tmp_path))
            remote.sdo.RESPONSE_TIMEOUT = 60.0
            for entry in node.objects:
                if entry.value is None:
                    continue
                signed = entry.type.startswith("integer")
                data = remote.sdo.upload(entry.index, entry.subindex)
                assert len(data) == (OBJECT_TYPES[entry.type][1] + 7) // 8, entry.name
                assert int.from_bytes(data, "little", signed=signed) == entry.value, entry.name


# -- cantools ------------------------------------------------------------------------------------


def test_our_codec_and_cantools_agree(robot: Robot, files: dict[str, bytes]) -> None:
    draw = random.Random(1)
    databases: dict[str, Any] = {}
    for bus in robot.buses:
        text = dbc_of(robot, bus, files).decode("cp1252")
        databases[bus.name] = cantools.database.load_string(text, "dbc")
    frames = [(bus.name, frame) for bus in robot.buses for frame in bus.frames if frame.signals]
    for bus_name, frame in frames:
        codec = FrameCodec(frame)
        message = dbc_message(databases[bus_name], frame)
        for _ in range(5):
            data = draw.randbytes(frame.length)
            chooser = next((s for s in frame.signals if s.multiplexer), None)
            if chooser is not None:
                at = chooser.start // 8
                choice = draw.choice([raw for s in frame.signals for raw in s.selected_by])
                data = data[:at] + bytes([choice]) + data[at + 1 :]
            if not codec.is_finite(data):
                continue
            theirs = message.decode(data, decode_choices=False, scaling=True)
            ours = codec.decode_named(data)
            assert ours == pytest.approx(theirs, rel=1e-12), frame.name
            if chooser is None:
                kept = {s.name: ours[s.name] for s in frame.signals}
                within = all(
                    (s.minimum is None or kept[s.name] >= s.minimum)
                    and (s.maximum is None or kept[s.name] <= s.maximum)
                    for s in frame.signals
                )
                if within:
                    assert codec.encode_named(kept) == message.encode(kept, strict=False)


@pytest.mark.parametrize("name", mostly_slow(["4wd4ws_wide", "cia402", "uneven"]))
def test_cantools_decodes_the_commands_of_the_driver(name: str) -> None:
    """Decoded with our DBC, commands equal the targets, and reports equal the motor states."""
    made = {"cia402": cia402_robot, "uneven": uneven_robot}
    rig = Rig(made[name]() if name in made else example_robot(name))
    read = cantools.database.load_string(
        files_of(Can, rig.robot)["can/robot.dbc"].decode("cp1252"), "dbc"
    )
    rig.drive(Twist(0.4, 0.0, 0.2), 4.0)
    last = {frame.id: frame.data for _, frame in rig.frames}
    controllers = [c for connection in rig.base.connections for c in connection.controllers]
    axes = {axis.joint: axis for c in controllers for axis in c.axes}
    checked = 0
    for frame in rig.robot.buses[0].frames:
        if frame.kind != "pdo" or frame.period is None or frame.cob_id not in last:
            continue
        values = read.decode_message(frame.cob_id, last[frame.cob_id], decode_choices=False)
        for signal in frame.signals:
            if signal.joint is None or "max" in signal.name:
                continue
            axis = axes[signal.joint]
            if signal.unit != ("rad" if axis.steering else "rad/s"):
                continue
            motor = rig.simulated.motors[axis.actuator.name].read(rig.now)
            measured = motor.position if axis.steering else motor.velocity
            expected = axis.target if frame.producer == "master" else measured
            assert values[signal.name] == pytest.approx(expected, abs=0.02), signal.name
            checked += 1
    assert checked == 2 * len(axes), "a command and a report of each motor"
