"""Known defects of the original software and of others, one end-to-end test each.

Each would have caught the fault where it was made.  The parts have tests of their own.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml

from tests.backend_files import files_of
from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.simulation.bus.robots import cia402_robot, drives
from thorvaldc.backends.can import Can
from thorvaldc.can.frame import CanFrame
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.frame_receiver import FrameReceiver
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.simulation.bus.battery_and_io_devices import BATTERY_FRAMES
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

COMMAND, STATE = 0x240, 0x1C0
"""Command and report of the sprayer, a foreign device."""


def compiled(folder: Path, text: str) -> tuple[Robot | None, list[str]]:
    """Returns the robot, ``None`` after errors, and the names of the errors."""
    path = folder / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    compilation = compile_file(path)
    robot = compilation.model if isinstance(compilation.model, Robot) else None
    return robot, [d.code.name for d in compilation.report.errors]


# -- the original: batteries ------------------------------------------------------------------


def test_all_frames_of_a_battery_are_the_batterys() -> None:
    """The original parser read one frame of three; two leaked to the foreign devices."""
    rig = Rig(drives())
    sent = set[int]()
    rig.simulated.wire().observers.append(lambda _, frame, __: sent.add(frame.id))
    rig.ready()
    assert {first + 1 for first in BATTERY_FRAMES} <= sent
    battery = rig.base.batteries()["battery"]
    for value in (battery.voltage, battery.current, battery.charge, *battery.temperatures):
        assert math.isfinite(value)
    assert {relayed.frame.id for relayed in rig.base.nodes.from_devices()} <= {STATE}


@pytest.mark.parametrize(
    ("battery", "drive", "refused"),
    [(1, 65, True), (1, 81, True), (1, 97, True), (1, 63, False), (16, 2, True), (15, 2, False)],
)
def test_the_frames_of_a_battery_are_not_those_of_a_drive(
    tmp_path: Path, battery: int, drive: int, refused: bool
) -> None:
    """Battery b uses the COB-IDs of nodes 64+b, 80+b and 96+b; ids from 16 on collide."""
    text = f"""
thorvaldc: 1
name: clash
modules:
  frame: {{type: frame/tube_rectangular, params: {{length: 1.2 m, width: 800 mm}}}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left, can: {drive}}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right, can: 4}}
  rl: {{type: caster/swivel, mount: frame.rear_left}}
  rr: {{type: caster/swivel, mount: frame.rear_right}}
  battery: {{type: battery/enclosure, mount: {{parent: frame, xyz: [0, 0, 0.07]}}, can: {battery}}}
"""
    errors = compiled(tmp_path, text)[1]
    assert any(name.startswith("can-") for name in errors) == refused, errors


# -- the original: receiving and sending ------------------------------------------------------


def test_a_full_receive_queue_keeps_the_newest() -> None:
    """The original kept the oldest frames, so the robot used old measurements."""
    wire = Wire(Timeline())
    receiver = FrameReceiver(VirtualTimeInterface(wire, "driver"), {0x701}, limit=8)
    node = VirtualTimeInterface(wire, "node")
    for number in range(30):
        node.send(CanFrame(0x701, bytes([number])), timeout=1.0)
    node.sleep(0.1)
    assert [data[0] for _, _, data in receiver.drain()] == list(range(22, 30))
    assert receiver.latest[0x701].data == bytes([29])
    assert receiver.dropped == 22


def test_a_failed_send_is_detected() -> None:
    """The original ignored the results of writes."""
    rig = Rig(example_robot("4wd4ws_wide"))
    rig.drive(seconds=1.0)
    complete = rig.base.cycles
    sends = rig.interface.send
    rig.interface.send = lambda frame, timeout=0.0: False  # type: ignore[method-assign]
    took = rig.until(lambda: rig.state is BaseState.FAULT, 0.5)
    assert took <= 0.1
    assert "frames cannot be sent" in rig.reason
    assert rig.base.cycles <= complete + 1
    assert rig.base.connections[0].not_sent > 0
    rig.interface.send = sends  # type: ignore[method-assign]


def test_a_hundred_frames_for_a_device_are_not_all_lost() -> None:
    """With 100 device frames in a cycle the original dropped all of them without a message."""
    rig = Rig(drives())
    rig.ready()
    at = len(rig.frames)
    refused = 0
    for number in range(100):
        try:
            rig.base.nodes.send_to_device(CanFrame(COMMAND, bytes([number])), rig.now)
        except RequestRefused:
            refused += 1
    rig.run(0.5)
    passed = [frame for _, frame in rig.frames[at:] if frame.id == COMMAND]
    assert passed
    assert len(passed) + refused == 100
    assert sum(rig.base.nodes.relay_drops().values()) == refused


def test_the_relay_passes_allowed_identifiers_only() -> None:
    """In the original any program could send any identifier, to the drives or as the master."""
    rig = Rig(drives())
    rig.ready()
    for cob_id in (0x000, 0x080, 0x201, 0x601, 0x77F):
        with pytest.raises(RequestRefused, match="not allowed"):
            rig.base.nodes.send_to_device(CanFrame(cob_id, b"\xaa\xbb"), rig.now)
    rig.run(0.2)
    assert all(frame.data != b"\xaa\xbb" for _, frame in rig.frames)


# -- the original: the controllers, and the stop ----------------------------------------------


def test_another_script_in_a_controller_is_detected() -> None:
    """In the original the check was commented out."""
    rig = Rig(example_robot("4wd4ws_wide"))
    drive = rig.simulated.devices["rr_controller"]
    assert isinstance(drive, RoboteqController)
    drive.version = (0, 9, 0)
    rig.until(lambda: rig.state is BaseState.FAULT)
    assert "rr_controller" in rig.reason
    assert "0.9.0" in rig.reason
    rig.twist = FORWARD
    rig.run(1.0)
    assert rig.speed() == 0.0


def test_the_safety_stop_does_more_than_command_zero() -> None:
    """The original only set the speeds to zero: the next command moved the robot again."""
    for robot in (example_robot("4wd4ws_wide"), drives()):
        rig = Rig(robot)
        rig.drive()
        rig.driven.safety_stop()
        rig.run(2.0)  # motion is still commanded
        assert rig.state is BaseState.ESTOP
        assert rig.speed() == 0.0
        rig.base.state_machine.ladder.holds_without_torque = True
        rig.run(0.1)
        assert all(c.is_off for connection in rig.base.connections for c in connection.controllers)
        rig.driven.safety_stop(False)
        rig.run(1.0)
        assert rig.state is BaseState.ESTOP, "a release alone does not start motion"
        assert rig.speed() == 0.0


# -- the original: one robot ------------------------------------------------------------------


def test_two_robots_in_one_simulation_are_detected() -> None:
    """A launch file used the description of one robot and the driver file of another."""
    wide, tall = example_robot("4wd4ws_wide"), example_robot("4wd2ws_tall")
    with pytest.raises(DiagnosticError, match="the scene has no joint"):
        MujocoBase(wide, MujocoScene(emit(tall, ["mjcf"], Report())))


def test_quoted_numbers_and_booleans_are_errors(tmp_path: Path) -> None:
    """Some files quoted numbers and booleans, which changed their meaning."""
    text = """
thorvaldc: 1
name: quoted
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.2 m, width: 800 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, can: "1"}
  fr: {type: assembly/steered_drive, mount: frame.front_right, can: 2}
  rl: {type: caster/swivel, mount: frame.rear_left}
  rr: {type: caster/swivel, mount: frame.rear_right}
  board: {type: io/board, params: {relay_0_at_start: "true"}, can: 20}
"""
    robot, errors = compiled(tmp_path, text)
    assert robot is None or len(errors) >= 2, errors


# -- other software ---------------------------------------------------------------------------


def test_drives_stop_by_themselves_when_the_driver_hangs() -> None:
    """Robots kept moving when ROS died, or while another loop refreshed their watchdogs."""
    for robot in (example_robot("4wd4ws_wide"), drives()):
        rig = Rig(robot)
        rig.drive()
        hung = rig.now
        assert rig.speed() > 0.4
        rig.simulated.run(2.0)  # no control cycle
        rig.frames = [(t, f) for t, f in rig.frames if t / 1e9 > hung + 0.02]
        master_ids = {f.cob_id for f in robot.buses[0].frames if f.producer == "master"}
        assert not [frame for _, frame in rig.frames if frame.id in master_ids]
        assert rig.speed() == 0.0


def test_heartbeats_are_on_for_ros2_canopen() -> None:
    """ros2_canopen disables them by default."""
    nodes = yaml.safe_load(files_of(Can, cia402_robot())["can/bus.yml"])
    assert nodes["master"]["heartbeat_producer"] > 0
    for name, node in nodes["nodes"].items():
        if name.endswith("_controller"):
            assert node["heartbeat_producer"] > 0
            assert node["heartbeat_consumer"] is True


def test_nothing_jumps_when_the_driver_continues_after_a_fault() -> None:
    """A controller that was activated again moved to its old target."""
    rig = Rig(drives())
    rig.drive()
    device = rig.simulated.devices["fl_controller"]
    device.power_off()
    rig.until(lambda: rig.state is BaseState.FAULT, 2.0)
    device.power_on()
    rig.until(lambda: rig.speed() == 0.0, 3.0)
    with pytest.raises(RequestRefused, match="command zero first"):
        rig.driven.reset()
    rig.twist = ZERO_TWIST
    rig.run(0.5)
    rig.driven.reset()
    rig.ready()
    rig.run(1.0)
    assert rig.speed() == 0.0
